"""The picture of a campaign: its text, and that nothing of it lies on something else."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from smarttac_can.science.population.trial import Campaign
from smarttac_can.studies.campaign.runner import COLUMNS, Result
from smarttac_can.studies.campaign.summary import LIMIT_CYCLE, distributions, summary
from smarttac_can.vocabulary.states import Law, VibrationLaw

FINGERS = 50


def rows(low, high):
    """Fingers whose figures are spread over a range, the same for all columns."""
    return np.tile(np.geomspace(low, high, FINGERS)[:, np.newaxis], len(COLUMNS))


def summed(of_law, campaign=None):
    return summary(campaign or Campaign(), Result(of_law, 1.0, 1.0, 0.0, True))


def rendered(figure):
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return figure, canvas.get_renderer()


def drawn(low, high):
    of_law = rows(low, high)
    return rendered(distributions([summed(of_law)], [of_law]))


RANGES = [
    (2.1, 2.9),
    (0.8, 3.0),
    (1.0, 12.0),
    (0.9, 99.0),
    (0.003, 30.0),
    (1e-6, 900.0),
    (3.0, 3.0),
]


def labels(axis):
    """Labels of the ticks of an axis that are seen."""
    low, high = sorted(axis.get_view_interval())
    ticks = zip(
        [*axis.get_majorticklocs(), *axis.get_minorticklocs()],
        [*axis.get_majorticklabels(), *axis.get_minorticklabels()],
        strict=True,
    )
    return [text for at, text in ticks if low <= at <= high and text.get_text()]


def under_all_laws(low, high):
    campaigns = [Campaign(1, law, VibrationLaw.PREDICTIVE) for law in Law]
    fingers = [rows(low, high)] * len(campaigns)
    pairs = zip(fingers, campaigns, strict=True)
    return rendered(distributions([summed(*pair) for pair in pairs], fingers))


@pytest.mark.parametrize(
    ("draw", "low", "high"), [*((drawn, *of) for of in RANGES), (under_all_laws, 0.9, 99.0)]
)
def test_no_text_lies_on_another(draw, low, high):
    figure, renderer = draw(low, high)
    texts = [figure._suptitle, *figure.legends]
    for axes in figure.axes:
        ticks = [*labels(axes.xaxis), *(labels(axes.yaxis) if axes.get_ylabel() else [])]
        names = [label for label in (axes.xaxis.label, axes.yaxis.label) if label.get_text()]
        texts += [*names, *ticks]
    boxes = [text.get_window_extent(renderer).padded(1.0) for text in texts]
    for one, other in combinations(boxes, 2):
        assert not one.overlaps(other)


@pytest.mark.parametrize(("low", "high"), RANGES[:-1])
def test_each_axis_has_two_plain_numbers_at_least(low, high):
    figure, _ = drawn(low, high)
    for axes in figure.axes:
        numbers = [text.get_text() for text in labels(axes.xaxis)]
        assert 2 <= len(numbers) <= 8
        assert all(float(number) > 0 for number in numbers)


def test_campaign_figure_names_plate_law_and_number_of_fingers():
    figure, _ = drawn(0.9, 99.0)
    title, what = figure.get_suptitle().splitlines()
    assert title == "Random fingers under control (simulated)"
    assert what.startswith("50 fingers, seed 1, law measured")
    chatter = figure.axes[3]
    (note,) = chatter.texts
    assert note.get_text() == f"limit cycle above {LIMIT_CYCLE:g}"
    assert note.xy[0] == LIMIT_CYCLE


def test_a_single_finger_is_seen():
    of_law = np.full((1, len(COLUMNS)), 2.0)
    figure = distributions([summed(of_law)], [of_law])
    for axes in figure.axes:
        curves = [line for line in axes.lines if not line.get_label().startswith("_")]
        for curve in curves:
            assert curve.get_xydata()[[0, -1]].tolist() == [[2.0, 0.0], [2.0, 100.0]]


def test_figures_that_no_finger_has_draw_nothing():
    of_law = np.full((2, len(COLUMNS)), np.nan)
    figure = distributions([summed(of_law)], [of_law])
    assert not any(curve.get_xydata().size for axes in figure.axes for curve in axes.lines[:2])


def test_each_law_has_a_curve_and_one_of_its_single_touches():
    figure, _ = under_all_laws(1.0, 9.0)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    names = [f"{law.name.lower()} + predictive" for law in Law]
    assert labels == [text for name in names for text in (name, f"{name}, single touches")]
    rise, _, static, _ = figure.axes
    assert len(rise.lines) == 2 * len(Law)
    assert len({line.get_color() for line in rise.lines}) == len(Law)
    assert len(static.lines) == len(Law)
