"""From a feed to answers: observations, live agents, lines of answers."""
