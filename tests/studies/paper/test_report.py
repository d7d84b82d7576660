import base64
import re
from html.parser import HTMLParser

import matplotlib as mpl
import numpy as np
import pytest
from synthetic_traces import all_experiments, trace

from smarttac_can import __version__
from smarttac_can.studies.paper.experiments import Conditions
from smarttac_can.studies.paper.references import PUBLISHED
from smarttac_can.studies.paper.report import compare, table_text, write_report
from smarttac_can.studies.paper.reproduce import CHOSEN, EMERGES, fitted, summary

VOID = {"meta", "img", "link", "br"}
ODD = "c0ffee & <b>$law</b>"


def summary_of(traces):
    return summary(traces, Conditions(seed=7, dead_time=450.0), link="bus", trace_sha256=ODD)


def verdicts(summary):
    return {item.published.key: item.verdict for item in compare(summary)}


class Page(HTMLParser):
    """Checks that tags match, and collects pictures, words and everything that would be fetched."""

    def __init__(self, text):
        super().__init__()
        self.open, self.images, self.fetched, self.words = [], [], [], []
        self.links, self.places = [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attributes:
            if name == "src" and value.startswith("data:image/png;base64,"):
                self.images.append(base64.b64decode(value.split(",", 1)[1], validate=True))
            elif name == "href" and value.startswith("#"):
                self.links.append(value[1:])
            elif name in {"src", "href", "srcset", "data"}:
                self.fetched.append(value)
            elif name == "id":
                self.places.append(value)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "new"
    traces = all_experiments()
    page = write_report(folder, traces, summary_of(traces))
    return page, page.read_text(encoding="utf-8")


def test_the_page_stands_alone(report):
    index, text = report
    page = Page(text)
    assert page.fetched == []
    assert not re.search(r"url\(|@import|<script|https?:", text)
    files = [index.with_name(f"fig{n}.png").read_bytes() for n in (7, 2, 3, 5, 6)]
    assert page.images == files
    assert all(picture.startswith(b"\x89PNG") for picture in files)


def test_picture_verdicts_figures_and_table_in_this_order(report):
    _, text = report
    marks = (
        'id="fig7"', "9 of 9 judged results", '<span class="inside">✓ ', 'id="fig2"',
        "Result and paper", "<h2>What was fitted",
    )  # fmt: skip
    places = [text.index(mark) for mark in marks]
    assert places == sorted(places)


def test_each_figure_zooms_and_closes_again(report):
    page = Page(report[1])
    names = [f"fig{number}" for number in (7, 2, 3, 5, 6)]
    assert page.links == [place for name in names for place in (f"zoom-{name}", name)]
    assert set(page.links) <= set(page.places)
    assert ".zoom:target {" in report[1]


def test_each_figure_is_there_as_svg_and_shows_no_day(report):
    index, _ = report
    for number in (2, 3, 5, 6, 7):
        svg = index.with_name(f"fig{number}.svg").read_text(encoding="utf-8")
        assert "</svg>" in svg
        assert "dc:date" not in svg
        assert f"v{mpl.__version__}" not in svg


def test_the_papers_numbers_stand_below_each_figure(report):
    figures = re.findall(r'<figure id="(\w+)">.*?</figure>', report[1], re.DOTALL)
    assert figures == ["fig7", "fig2", "fig3", "fig5", "fig6"]
    shown = {}
    for name in figures:
        figure = re.search(rf'<figure id="{name}">(.*?)</figure>', report[1], re.DOTALL)
        cells = re.findall(r"<td>(.*?)</td><td>(.*?)</td></tr>", figure[1])
        shown[name] = cells
    assert shown["fig2"] == shown["fig3"] == [], "the paper has no numbers on these"
    assert [paper for _, paper in shown["fig5"]] == ["2", "5", "1", "1", "43390"]
    assert shown["fig6"] == [("30.00 %", "30")]
    assert [paper for _, paper in shown["fig7"]][:5] == ["3.84", "37.5", "-", "1.27", "10.2"]
    assert len(shown["fig7"]) == 5 + 2 * 4
    assert all(ours != "-" for cells in shown.values() for ours, _ in cells)


def test_the_page_holds_the_run_and_its_results(report):
    words = " ".join("".join(Page(report[1]).words).split())
    for expected in (
        "450 us",
        "measured",
        "bus",
        "c0ffee",
        "43390 Hz",
        "30.00 %",
        "simulated",
        "Down-step, single touches",
        "9 of 9 judged results",
    ):
        assert expected in words, expected
    assert "Results that do not exist" not in words


def test_text_of_a_run_is_text(report):
    assert ODD in "".join(Page(report[1]).words)


def test_report_has_chosen_figures_before_emergent_ones(report):
    words = "".join(Page(report[1]).words)
    told = (*fitted("presets"), "Chosen, then checked", *CHOSEN, "Emerges", *EMERGES)
    places = [words.index(each) for each in told]
    assert places == sorted(places)


def test_response_times_are_chosen_and_then_checked():
    origins = {p.key: p.origin for p in PUBLISHED}
    assert {key for key, origin in origins.items() if origin == "chosen"} == {
        "fig5.amplitude_and_frequency.response_time_ms",
        "fig5.amplitude_only.response_time_ms",
    }
    lines = table_text(summary_of(all_experiments())).splitlines()
    (row,) = (line for line in lines if line.startswith("5 % response time, both loops"))
    assert row.split()[6] == "chosen"


def test_same_input_same_page(report, tmp_path):
    traces = all_experiments()
    again = write_report(tmp_path, traces, summary_of(traces))
    assert again.read_text(encoding="utf-8") == report[1]
    for number in (2, 3, 5, 6, 7):
        svg = f"fig{number}.svg"
        assert (tmp_path / svg).read_bytes() == report[0].with_name(svg).read_bytes()


def test_partial_report_names_missing_experiments(tmp_path):
    traces = [t for t in all_experiments() if t.experiment.startswith("fig2")]
    page = write_report(tmp_path, traces, summary_of(traces))
    words = "".join(Page(page.read_text(encoding="utf-8")).words)
    assert "Fig. 5: fig5.amplitude_and_frequency was not run." in words
    assert "Results that do not exist" not in words
    assert "5 % response time" not in words
    assert sorted(path.name for path in tmp_path.glob("*.png")) == ["fig2.png", "fig3.png"]


def test_a_value_at_the_bound_is_inside_and_beyond_it_outside():
    result = summary_of(all_experiments())
    key = "fig6.voltage_difference_percent"
    (published,) = (p for p in PUBLISHED if p.key == key)
    for value, verdict in (
        (published.low, "inside"),
        (published.high, "inside"),
        (published.low - 1e-9, "outside"),
        (published.high + 1e-9, "outside"),
    ):
        result["fig6"]["voltage_difference_percent"] = value
        assert verdicts(result)[key] == verdict


def without_voltage():
    """All experiments, of which one gave nothing that can be measured."""
    runs = [t for t in all_experiments() if t.experiment != "fig5.amplitude_only"]
    return [*runs, trace("fig5.amplitude_only", 0, W=np.zeros(60), V=np.zeros(60))]


def test_report_compares_each_run_and_judges_no_single_subject():
    items = {item.published.key: item for item in compare(summary_of(all_experiments()))}
    assert len(items) == len(PUBLISHED)
    assert all(item.value is not None and item.reason == "" for item in items.values())
    assert items["table1.subjects[3].rise_time_ms"].verdict == ""
    assert items["table1.mean.rise_time_ms"].verdict == "inside"
    assert compare(summary_of([])) == []
    text = table_text(summary_of([]))
    assert text.startswith("The paper gives no number for this.\n\nseed")


def test_missing_results_bring_their_reason():
    items = {item.published.key: item for item in compare(summary_of(without_voltage()))}
    missing = items["fig5.amplitude_only.response_time_ms"]
    assert missing.reason == "fig5.amplitude_only has no voltage"
    assert missing.verdict == "missing"
    key = "fig5.amplitude_only.response_time_ms"
    line = f"missing {key}: fig5.amplitude_only has no voltage"
    assert line in table_text(summary_of(without_voltage()))


def test_table_text_is_plain_and_aligned():
    text = table_text(summary_of(all_experiments()))
    assert text.isascii()
    lines = text.splitlines()
    (row,) = (line for line in lines if line.startswith("More voltage"))
    assert row.split()[-6:] == ["%", "30", "28", "to", "32", "inside"]
    end = lines[0].index("paper") + len("paper")
    assert row[:end].endswith(" 30")
    run = "seed 7, law measured, vibration law pi, link bus, dead time 450 us"
    assert f"{run}, version {__version__}" in text
    assert "missing" not in text
