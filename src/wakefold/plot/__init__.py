"""Pictures: tracks, the filtration beside its tracks, beliefs over time and level, forecasts, relations, events.

Every function returns a `matplotlib.figure.Figure` of its own: no global state, no display needed, and the same
input gives the same file. Write it with `save`.
"""

from wakefold.plot.ahead import Ahead, forecast
from wakefold.plot.belief import Moment, beliefs
from wakefold.plot.canvas import save
from wakefold.plot.events import event
from wakefold.plot.map import tracks
from wakefold.plot.scene import relations
from wakefold.plot.tree import filtration

__all__ = ["Ahead", "Moment", "beliefs", "event", "filtration", "forecast", "relations", "save", "tracks"]
