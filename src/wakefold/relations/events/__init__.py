"""Events of ships: encounters, rendezvous, convoys, loitering, port visits."""
