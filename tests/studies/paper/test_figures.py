from io import BytesIO

import matplotlib as mpl
import numpy as np
import pytest
from synthetic_traces import all_experiments, friction, trace, vibration

from smarttac_can.science.population.steps import UndefinedError
from smarttac_can.studies.paper import figures
from smarttac_can.studies.paper.metrics import align_at_switch, find, friction_ratio_percent

LAW = {"fig7": ["measured"]}


def law(error):
    return 1e-6 * max(-1.0, min(1.0, 0.04 * error))


@pytest.fixture(scope="module")
def traces():
    return all_experiments()


def drawn(figure):
    """Render the figure, as layout and glyphs are only found to be wrong then."""
    figure.savefig(BytesIO(), format="png", dpi=50)
    return figure


def lines(axes):
    return {line.get_label(): line for line in axes.lines}


def words(axes):
    return " ".join(text.get_text() for text in axes.texts)


def test_fig2_shows_every_ratio_and_the_mean(traces):
    (axes,) = drawn(figures.fig2(traces)).axes
    curves = lines(axes)
    ratios = [curves[f"subject {i}"].get_ydata() for i in range(1, 6)]
    assert ratios[2][3] == friction_ratio_percent(traces, 3, 1.5)
    np.testing.assert_allclose(curves["mean"].get_ydata(), np.mean(ratios, axis=0))
    assert list(curves["mean"].get_xdata()) == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert curves["mean"].get_color() == figures.RED
    assert len({curves[f"subject {i}"].get_marker() for i in range(1, 6)}) == 5


def test_fig2_leaves_a_hole_where_there_is_no_ratio(traces):
    holed = [t for t in traces if (t.experiment, t.subject) != ("fig2.1.0", 2)]
    curves = lines(drawn(figures.fig2(holed)).axes[0])
    assert list(np.isnan(curves["subject 2"].get_ydata())) == [False, False, True, False, False]
    assert list(np.isnan(curves["mean"].get_ydata())) == [False, False, True, False, False]


def test_fig3_is_the_law_in_um():
    (axes,) = drawn(figures.fig3(law)).axes
    curve = axes.lines[-1]
    increments = dict(zip(np.round(curve.get_xdata(), 6), curve.get_ydata(), strict=True))
    assert [increments[e] for e in (-50, -25, 0, 10, 25, 50)] == pytest.approx(
        [-1, -1, 0, 0.4, 1, 1]
    )


def test_fig5_starts_at_switch_on_and_marks_the_response_times(traces):
    (axes,) = drawn(figures.fig5(traces)).axes
    curves = lines(axes)
    both = curves["amplitude and frequency loops"]
    run = find(traces, "fig5.amplitude_and_frequency")
    assert both.get_ydata()[0] == 0
    assert both.get_ydata()[1] == run.amplitude_um[6] > 0
    assert both.get_color() == figures.RED
    assert curves["amplitude loop only"].get_color() == figures.GREEN
    assert "2.2 ms (paper 2)" in words(axes)
    assert "5.1 ms (paper 5)" in words(axes)


@pytest.mark.parametrize("swapped", [False, True])
def test_fig5_notes_lie_over_no_line(traces, swapped):
    if swapped:
        slow = vibration("amplitude_and_frequency", 1.6, 26.0, 43_250.0)
        traces = [vibration("amplitude_only", 0.7, 20.0, 43_390.0), slow]
    figure = drawn(figures.fig5(traces))
    figure.canvas.draw()
    (axes,) = figure.axes
    dotted = [line for line in axes.lines if line.get_linestyle() == ":"]
    notes = [text for text in axes.texts if " ms" in text.get_text()]
    assert len(dotted) == len(notes) == 2
    for note in notes:
        box = note.get_window_extent().transformed(axes.transData.inverted())
        for line in dotted:
            (x, _), (bottom, _) = line.get_data()
            assert not (box.x0 < x < box.x1 and bottom < box.y1)


def test_fig5_marks_no_response_time_that_does_not_exist():
    slow = [vibration("amplitude_only", 40, 26.0, 43_250.0)]
    fast = [vibration("amplitude_and_frequency", 0.7, 20.0, 43_390.0)]
    assert words(drawn(figures.fig5(slow + fast)).axes[0]).count(" ms") == 1


def test_fig6_shows_the_difference(traces):
    (axes,) = drawn(figures.fig6(traces)).axes
    assert "+30.0 % (paper 30)" in words(axes)
    only = find(traces, "fig5.amplitude_only").voltage_v[5:]
    np.testing.assert_array_equal(lines(axes)["amplitude loop only"].get_ydata(), only)


def test_fig7_has_touches_mean_and_reference_in_both_directions(traces):
    figure = drawn(figures.fig7(traces, "measured"))
    assert len(figure.axes) == 8
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles[:3] == ["Subject 1, up-step", "Subject 1, down-step", "Subject 2, up-step"]
    touches = align_at_switch([find(traces, "table1", 2)], up=True)
    *single, reference, mean = figure.axes[2].lines
    assert len(single) == len(touches.steps) == 12
    np.testing.assert_array_equal(mean.get_ydata(), touches.mean_curve().mu)
    assert set(reference.get_ydata()) == {0.3, 0.4}
    assert reference.get_ydata()[20] == 0.4
    up, down = words(figure.axes[2]), words(figure.axes[3])
    assert "12 touches" in up
    assert up.count("(paper") == 2
    assert "ms (paper 3.41)\n" in up
    assert "% (paper 44.4)\n" in up
    assert "paper" not in down, "Table I is of the up-steps"


def test_fig7_legend_shows_each_kind_of_line(traces):
    """A touch in a panel is thin and pale, as many of them lie over each other."""
    (legend,) = drawn(figures.fig7(traces, "measured")).legends
    for line in legend.get_lines():
        assert line.get_linewidth() >= 1.5
        assert line.get_alpha() in (None, 1.0)


def test_fig7_names_its_law_and_its_rows_align(traces):
    # COFs of one and of three digits make tick labels of other widths.
    figure = drawn(
        figures.fig7([*traces, friction(3, 0.2, 0.3), friction(4, 0.2125, 0.2325)], "nominal")
    )
    assert "law nominal (simulated)" in figure.get_suptitle()
    places = [axes.get_position() for axes in figure.axes]
    for above, below in zip(places[:4], places[4:8], strict=True):
        assert (above.x0, above.x1) == pytest.approx((below.x0, below.x1), abs=1e-9)
    for row in (places[:4], places[4:8]):
        assert np.ptp([place.y0 for place in row]) == pytest.approx(0.0, abs=1e-9)


def test_fig7_labels_its_panels_by_two_digits():
    runs = [friction(1, 0.2, 0.3), friction(2, 0.3, 0.4), friction(3, 0.2, 0.25)]
    figure = drawn(figures.fig7(runs, "measured"))
    numbers = {text.get_text() for axes in figure.axes for text in axes.get_yticklabels()}
    assert {len(number) for number in numbers} == {len("0.25")}


def test_fig7_says_why_a_panel_is_empty():
    no_down = drawn(figures.fig7([friction(1, 0.2, 0.3, passes=2)], "measured"))
    assert "no whole touch" in words(no_down.axes[1])
    still = trace("table1", 2, mu=np.full(400, 2500), mu_ref=np.repeat([2000, 3000], 200))
    assert "0 % of the step" in words(drawn(figures.fig7([still], "measured")).axes[0])


@pytest.mark.parametrize("name", ["fig2", "fig5", "fig6", "fig7"])
def test_every_picture_of_a_run_says_simulated(traces, name):
    figure = getattr(figures, name)(traces, *LAW.get(name, ()))
    titles = [figure.get_suptitle(), *(axes.get_title(loc="left") for axes in figure.axes)]
    assert any("(simulated)" in title for title in titles)


@pytest.mark.parametrize("name", ["fig2", "fig5", "fig6", "fig7"])
def test_figure_of_an_experiment_not_run_is_refused(name):
    with pytest.raises(UndefinedError, match="was not run"):
        getattr(figures, name)([], *LAW.get(name, ()))


def test_drawing_leaves_the_users_matplotlib_alone(traces):
    with mpl.rc_context({"axes.edgecolor": "#123456"}):
        drawn(figures.fig2(traces))
        assert mpl.rcParams["axes.edgecolor"] == "#123456"
