"""The results beside the paper's: as text for the terminal, and as one page with its figures.

The page is self-contained: style and pictures are inside, nothing is fetched. Figures need
matplotlib (extra ``report``); `table_text` and `compare` do not.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

from smarttac_can.bench.traces import Trace
from smarttac_can.science.population.steps import UndefinedError
from smarttac_can.studies.paper.metrics import LOOPS
from smarttac_can.studies.paper.references import PUBLISHED, TITLE, Published
from smarttac_can.studies.paper.reproduce import (
    CANDUMP,
    CHOSEN,
    EMERGES,
    RESULTS,
    TRACES,
    Progress,
    fitted,
    friction_step,
)

INSIDE, OUTSIDE, MISSING, NOT_JUDGED = "inside", "outside", "missing", ""
_MARKS = {INSIDE: "✓", OUTSIDE: "✗", MISSING: "?"}
_NUMBERS_OF = {"fig7": "table1"}
"""Key of the numbers of a figure, if it is not the name of the figure."""
_WHOLE_FROM = 1000
INDEX = "index.html"
CAPTIONS = {
    "fig2": "Friction that a vibration leaves of the friction without one, at five regulated "
    "amplitudes. Points: subjects, set a little aside of each other. Red: their mean.",
    "fig3": "Increment of the vibration amplitude that the friction law asks for at a friction "
    "error E. This is the law itself, not a measurement.",
    "fig5": "Switch-on at the resonance of 30 °C while the plate is at 20 °C, 140 Hz off. Dotted: "
    "where the amplitude enters the 5 % band for good. One point a tick of 1 ms.",
    "fig6": "The voltage behind the runs of Fig. 5, held over each tick. The difference is between "
    "the means over the last 20 ms, in % of the voltage with both loops.",
    "fig7": "Coefficient of friction around the switch of the reference, which follows the "
    "position of the finger. Rise or fall from 10 to 90 % and overshoot are those of the mean "
    "curve, in % of the step between its own levels before the switch and from 40 ms on.",
}
FILES = (
    *(TRACES, RESULTS, CANDUMP, INDEX),
    *(f"{name}.{form}" for name in CAPTIONS for form in ("png", "svg")),
)
"""All files that the experiments and their report may create."""
_NAMES = dict(zip(LOOPS, ("amplitude loop alone", "both loops"), strict=True))
STEP_COLUMNS = {
    "rise_time_ms": "Rise or fall (ms)",
    "overshoot_percent": "Overshoot (%)",
    "static_error_percent": "Static error (%)",
}


class Comparison(NamedTuple):
    """A result beside the paper's figure."""

    published: Published
    value: float | None
    """The result; None if there is none."""
    reason: str
    """Why there is no result; empty if there is one."""

    @property
    def verdict(self) -> str:
        """``inside`` or ``outside`` the band, ``missing``, or empty if there is no band."""
        low, high = self.published.low, self.published.high
        if low is None or high is None:
            return NOT_JUDGED
        if self.value is None:
            return MISSING
        return INSIDE if low <= self.value <= high else OUTSIDE


def compare(summary: Mapping[str, Any]) -> list[Comparison]:
    """Compare results from `summary` of `studies.paper.reproduce` with the paper's figures."""
    comparisons = []
    for published in PUBLISHED:
        value = _look_up(summary, published.key)
        reason = summary["unavailable"].get(published.key, "")
        if value is not None or reason:
            comparisons.append(Comparison(published, value, reason))
    return comparisons


def table_text(summary: Mapping[str, Any]) -> str:
    """Return result, paper, band and verdict as plain text, with the run's parameters."""
    rows = [("", "", "result", "paper", "band", "")]
    rows += [
        (
            item.published.name,
            item.published.origin,
            _with_unit(item.value, item),
            *_paper_cells(item),
            item.verdict,
        )
        for item in compare(summary)
    ]
    if len(rows) == 1:
        rows = [("The paper gives no number for this.", "", "", "", "", "")]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        f"{name:<{widths[0]}}  {origin:<{widths[1]}}  {result:>{widths[2]}}  "
        f"{paper:>{widths[3]}}  {band:>{widths[4]}}  {verdict}".rstrip()
        for name, origin, result, paper, band, verdict in rows
    ]
    parameters = ", ".join(f"{name} {value}" for name, value in _parameters(summary))
    missing = [f"missing {key}: {reason}" for key, reason in summary["unavailable"].items()]
    return "\n".join([*lines, "", parameters, *missing]) + "\n"


def dead_time_table(without: Mapping[str, Any], with_it: Mapping[str, Any]) -> str:
    """Return the vibration results without and with dead time side by side, as plain text.

    Parameters
    ----------
    without, with_it
        Results from `smarttac_can.studies.paper.reproduce.summary`.
    """
    heads = [f"dead time {results['dead_time_us']:.0f} us" for results in (without, with_it)]
    lines = [f"{'':<40}" + "".join(f"{head:>20}" for head in heads) + f"{'paper':>10}"]
    others = {item.published.key: item for item in compare(with_it)}
    for one in compare(without):
        published = one.published
        other = others.get(published.key)
        if other is None or not published.key.startswith(("fig5", "fig6")):
            continue
        cells = "".join(
            f"{'-' if item.value is None else f'{item.value:.2f} {published.unit}':>20}"
            for item in (one, other)
        )
        lines.append(f"{published.name:<40}{cells}{published.value:>10g}")
    return "\n".join(lines) + "\n"


def vibration_table(results: Mapping[str, Any]) -> str:
    """Return overshoot, and settling after a step if there was one, as plain text.

    Parameters
    ----------
    results
        Results from `smarttac_can.studies.paper.reproduce.summary`, with Fig. 5.
    """
    lines = []
    for loops, name in _NAMES.items():
        run = results["fig5"][loops]
        lines.append(f"0 to 1 um, {name}: overshoot {_percent(run)}")
        step = run["step"]
        if step["settling_time_ms"] is not None:
            settled = f"settles in {step['settling_time_ms']:.2f} ms, overshoot {_percent(step)}"
            lines.append(f"1 to 1.5 um, {name}: {settled}")
    return "\n".join(lines) + "\n"


def write_report(
    directory: Path,
    traces: Iterable[Trace],
    summary: Mapping[str, Any],
    progress: Progress = lambda _share: None,
) -> Path:
    """Write ``fig*.png``, ``fig*.svg`` and the self-contained ``index.html`` into a directory.

    Parameters
    ----------
    directory
        Directory; created if it does not exist. Files of the same names are replaced.
    traces, summary
        Traces of the runs and their `smarttac_can.studies.paper.reproduce.summary`.
    progress
        Function called with the fraction of the figures that are drawn, 0..1.

    Returns
    -------
    Path
        Path of the page.
    """
    directory.mkdir(parents=True, exist_ok=True)
    traces = list(traces)
    sections, missing = [], []
    for number, (name, picture) in enumerate(_pictures(traces, summary["law"]), 1):
        progress(number / len(CAPTIONS))
        if isinstance(picture, UndefinedError):
            missing.append(f"<p>Fig. {name[3:]}: {escape(str(picture))}.</p>")
            continue
        for form, data in picture.items():
            (directory / f"{name}.{form}").write_bytes(data)
        sections.append(_figure_html(name, picture["png"], compare(summary)))
    page = Template(_page()).substitute(
        paper=escape(TITLE),
        parameters="".join(
            f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>"
            for name, value in _parameters(summary)
        ),
        first="".join(sections[:1]),
        verdict=escape(_headline(compare(summary))),
        verdicts="\n".join(map(_verdict_html, compare(summary))),
        comparison="".join(map(_comparison_html, compare(summary))),
        steps=_steps_html(summary["table1"]),
        figures="\n".join(sections[1:] + missing),
        fitted=_list_html(fitted(summary["subjects"])),
        chosen=_list_html(CHOSEN),
        emerges=_list_html(EMERGES),
        unavailable=_unavailable_html(summary["unavailable"]),
        sha256=escape(summary["trace_sha256"]),
    )
    index = directory / INDEX
    index.write_text(page, encoding="utf-8", newline="\n")
    return index


def _pictures(
    traces: list[Trace], law_name: str
) -> Iterator[tuple[str, dict[str, bytes] | UndefinedError]]:
    """Yield the name of each figure with its picture by format, or why there is none.

    The figure that shows the purpose of the instrument comes first.
    """
    from smarttac_can.bench.drawing import rendered  # noqa: PLC0415  matplotlib is an extra
    from smarttac_can.studies.paper import figures  # noqa: PLC0415

    draw: dict[str, Callable[[], Any]] = {
        "fig7": lambda: figures.fig7(traces, law_name),
        "fig2": lambda: figures.fig2(traces),
        "fig3": lambda: figures.fig3(friction_step),
        "fig5": lambda: figures.fig5(traces),
        "fig6": lambda: figures.fig6(traces),
    }
    for name, figure in draw.items():
        try:
            yield name, rendered(figure())
        except UndefinedError as reason:
            yield name, reason


def _percent(run: Mapping[str, Any]) -> str:
    overshoot = run["overshoot_percent"]
    return "-" if overshoot is None else f"{overshoot:.1f} %"


def _page() -> str:
    return resources.files(__package__).joinpath("page.html").read_text(encoding="utf-8")


def _look_up(summary: Mapping[str, Any], key: str) -> float | None:
    """Follow a key such as ``table1.subjects[0].rise_time_ms``; return None if it is missing."""
    value: Any = summary
    for name, index in re.findall(r"(\w+)|\[(\d+)\]", key):
        try:
            value = value[name or int(index)]
        except (KeyError, IndexError):
            return None
    return None if value is None else float(value)


def _parameters(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [
        ("seed", str(summary["seed"])),
        ("law", summary["law"]),
        ("vibration law", summary["vibration_law"]),
        *([("load", f"{summary['load_n']:g} N")] if summary["load_n"] else []),
        ("link", summary["link"]),
        ("dead time", f"{summary['dead_time_us']:g} us"),
        ("version", summary["version"]),
        ("subjects", summary["subjects"]),
    ]


def _number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= _WHOLE_FROM else f"{value:#.4g}".rstrip(".")


def _with_unit(value: float | None, item: Comparison) -> str:
    return "-" if value is None else f"{_number(value)} {item.published.unit}"


def _paper_cells(item: Comparison) -> tuple[str, str]:
    published = item.published
    paper = "-" if published.value is None else _plain(published.value)
    if published.low is None or published.high is None:
        return paper, ""
    return paper, f"{_plain(published.low)} to {_plain(published.high)}"


def _plain(value: float) -> str:
    return f"{value:.0f}" if value >= _WHOLE_FROM else f"{value:g}"


def _headline(comparisons: Sequence[Comparison]) -> str:
    judged = [item for item in comparisons if item.verdict != NOT_JUDGED]
    inside = sum(item.verdict == INSIDE for item in judged)
    return f"{inside} of {len(judged)} judged results lie inside the stated band."


def _comparison_html(item: Comparison) -> str:
    paper, band = _paper_cells(item)
    title = f' title="{escape(item.reason)}"' if item.reason else ""
    return (
        f'<tr><th scope="row">{escape(item.published.name)}<small>'
        f"{escape(item.published.where)}</small></th>"
        f"<td>{item.published.origin}</td>"
        f"<td{title}>{escape(_with_unit(item.value, item))}</td>"
        f"<td>{escape(paper)}</td><td>{escape(band)}</td>"
        f"<td>{_badge_html(item, item.verdict)}</td></tr>\n"
    )


def _verdict_html(item: Comparison) -> str:
    return _badge_html(item, f"{item.published.name}: {_with_unit(item.value, item)}")


def _badge_html(item: Comparison, text: str) -> str:
    """Return a text in the colour of the verdict; empty if there is no verdict."""
    if item.verdict == NOT_JUDGED:
        return ""
    return f'<span class="{item.verdict}">{_MARKS[item.verdict]} {escape(text)}</span>'


def _steps_html(table: Mapping[str, Any]) -> str:
    """Return rise, overshoot and static error of the subjects, by direction and by curve."""
    blocks = (
        ("Up-step, mean curve", table),
        ("Up-step, single touches", table["touches"]),
        ("Down-step, mean curve", table["down"]),
        ("Down-step, single touches", table["down"]["touches"]),
    )
    lines = []
    for title, block in blocks:
        heads = [f"subject {row['subject']}" for row in block["subjects"]]
        heads += ["mean", "std"]
        cells = "".join(f'<th scope="col">{escape(head)}</th>' for head in heads)
        lines.append(f'<tr class="block"><th scope="col">{title}</th>{cells}</tr>')
        for name, words in STEP_COLUMNS.items():
            values = [row[name] for row in (*block["subjects"], block["mean"], block["std"])]
            row = "".join(f"<td>{'-' if v is None else _number(v)}</td>" for v in values)
            lines.append(f'<tr><th scope="row">{escape(words)}</th>{row}</tr>')
    return "\n".join(lines)


def _figure_html(name: str, png: bytes, comparisons: Sequence[Comparison]) -> str:
    data, caption = base64.b64encode(png).decode("ascii"), escape(CAPTIONS[name])
    return (
        f'<figure id="{name}"><a class="zoom" id="zoom-{name}" href="#zoom-{name}">'
        f'<img alt="{caption}" src="data:image/png;base64,{data}"></a>'
        f'<a class="close" href="#{name}">close</a>'
        f"<figcaption><b>Fig. {name[3:]}</b> (simulated). {caption}</figcaption>"
        f"{_beside_html(name, comparisons)}</figure>"
    )


def _beside_html(name: str, comparisons: Sequence[Comparison]) -> str:
    """Return a table of the paper's numbers on a figure beside ours; empty if there are none."""
    rows = "".join(
        f'<tr><th scope="row">{escape(item.published.name)}</th>'
        f"<td>{escape(_with_unit(item.value, item))}</td>"
        f"<td>{escape(_paper_cells(item)[0])}</td></tr>\n"
        for item in comparisons
        if item.published.key.partition(".")[0] == _NUMBERS_OF.get(name, name)
    )
    if not rows:
        return ""
    head = '<th scope="col"></th><th scope="col">Simulated</th><th scope="col">Paper</th>'
    return (
        "<details><summary>Beside the paper's numbers</summary>"
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>\n{rows}</tbody></table></div></details>"
    )


def _list_html(sentences: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(sentence)}</li>" for sentence in sentences) + "</ul>"


def _unavailable_html(unavailable: Mapping[str, str]) -> str:
    if not unavailable:
        return ""
    rows = [f"{key}: {reason}" for key, reason in unavailable.items()]
    return "<h2>Results that do not exist</h2>" + _list_html(rows)
