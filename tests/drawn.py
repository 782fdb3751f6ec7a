"""What a figure holds: its artists by name, its words, and which of them lie on each other."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text


def by_gid(artist, gid: str) -> list:
    return artist.findobj(lambda part: part.get_gid() == gid)


def words(figure: Figure) -> str:
    return "\n".join(text.get_text() for text in figure.findobj(Text))


def overlapping_words(figure: Figure) -> list[tuple[str, str]]:
    """Pairs of words whose boxes overlap, labels of ticks that are not drawn left out."""
    figure.canvas.draw()
    texts = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    beyond = {id(label) for axes in figure.findobj(Axes) for label in _labels_beyond_the_limits(axes)}
    boxes = [(text.get_text(), text.get_window_extent().shrunk(0.98, 0.98)) for text in texts if id(text) not in beyond]
    return [(name, other) for i, (name, box) in enumerate(boxes) for other, below in boxes[:i] if box.overlaps(below)]


def _labels_beyond_the_limits(axes) -> list[Text]:
    labels = []
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        outside = [tick for tick in axis.get_major_ticks() if not low <= tick.get_loc() <= high]
        labels += [label for tick in outside for label in (tick.label1, tick.label2)]
    return labels
