"""The results beside the paper's: as text for the terminal and as one page with its figures.

The page stands alone: style and pictures are inside, nothing is fetched. Figures need matplotlib
(extra ``report``); `table_text` and `compare` do not.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from html import escape
from io import BytesIO
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

from smarttac_can.bench.metrics import UndefinedError
from smarttac_can.bench.paper import PUBLISHED, TITLE, Published
from smarttac_can.bench.traces import Trace

INSIDE, OUTSIDE, MISSING, NOT_JUDGED = "inside", "outside", "missing", ""
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
STEP_COLUMNS = {
    "rise_time_ms": "Rise or fall (ms)",
    "overshoot_percent": "Overshoot (%)",
    "static_error_percent": "Static error (%)",
}


class Comparison(NamedTuple):
    """A result beside the paper's figure."""

    published: Published
    value: float | None
    """The result; None where there is none."""
    reason: str
    """Why there is no result; empty where there is one."""

    @property
    def verdict(self) -> str:
        """``inside`` or ``outside`` the band, ``missing``, or empty where no band is stated."""
        low, high = self.published.low, self.published.high
        if low is None or high is None:
            return NOT_JUDGED
        if self.value is None:
            return MISSING
        return INSIDE if low <= self.value <= high else OUTSIDE


def compare(summary: Mapping[str, Any]) -> list[Comparison]:
    """Lay each of the paper's figures beside the result in a summary (`metrics.summary`)."""
    comparisons = []
    for published in PUBLISHED:
        value = _look_up(summary, published.key)
        reason = "" if value is not None else summary["unavailable"].get(published.key, "not run")
        comparisons.append(Comparison(published, value, reason))
    return comparisons


def table_text(summary: Mapping[str, Any]) -> str:
    """Result, paper, band and verdict as a table of plain text, with the run's parameters."""
    rows = [("", "result", "paper", "band", "")]
    rows += [
        (item.published.name, _with_unit(item.value, item), *_paper_cells(item), item.verdict)
        for item in compare(summary)
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        f"{name:<{widths[0]}}  {result:>{widths[1]}}  {paper:>{widths[2]}}  "
        f"{band:>{widths[3]}}  {verdict}".rstrip()
        for name, result, paper, band, verdict in rows
    ]
    parameters = ", ".join(f"{name} {value}" for name, value in _parameters(summary))
    missing = [f"missing {key}: {reason}" for key, reason in summary["unavailable"].items()]
    return "\n".join([*lines, "", parameters, *missing]) + "\n"


def write_report(
    directory: Path,
    traces: Iterable[Trace],
    summary: Mapping[str, Any],
    law: Callable[[float], float],
    *,
    fitted: Sequence[str],
    emerges: Sequence[str],
) -> Path:
    """Write ``fig*.png`` and the self-contained ``index.html`` into a directory.

    Parameters
    ----------
    directory
        Made if it does not exist; files of the same names are replaced.
    traces, summary
        The runs and their `metrics.summary`.
    law
        Eq. (9) for Fig. 3: E in % to dW in m.
    fitted, emerges
        What was chosen to meet the paper's figures, and what came out of it; plain sentences.

    Returns
    -------
    Path
        The page.
    """
    directory.mkdir(parents=True, exist_ok=True)
    traces = list(traces)
    sections = []
    for name, picture in _pictures(traces, law):
        if isinstance(picture, UndefinedError):
            sections.append(f"<p>Fig. {name[3:]}: {escape(str(picture))}.</p>")
            continue
        (directory / f"{name}.png").write_bytes(picture)
        sections.append(_figure_html(name, picture))
    page = Template(PAGE).substitute(
        paper=escape(TITLE),
        parameters="".join(
            f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>"
            for name, value in _parameters(summary)
        ),
        verdict=escape(_headline(compare(summary))),
        comparison="".join(map(_comparison_html, compare(summary))),
        steps=_steps_html(summary["table1"]),
        figures="\n".join(sections),
        fitted=_list_html(fitted),
        emerges=_list_html(emerges),
        unavailable=_unavailable_html(summary["unavailable"]),
        sha256=escape(summary["trace_sha256"]),
    )
    index = directory / "index.html"
    index.write_text(page, encoding="utf-8", newline="\n")
    return index


def _look_up(summary: Mapping[str, Any], key: str) -> float | None:
    """Follow a key such as ``table1.subjects[0].rise_time_ms``; None where it leads nowhere."""
    value: Any = summary
    for name, index in re.findall(r"(\w+)|\[(\d+)\]", key):
        try:
            value = value[name or int(index)]
        except (KeyError, IndexError):
            return None
    return None if value is None else float(value)


def _pictures(
    traces: list[Trace], law: Callable[[float], float]
) -> Iterator[tuple[str, bytes | UndefinedError]]:
    from smarttac_can.bench import figures  # noqa: PLC0415  matplotlib is an extra

    draw: dict[str, Callable[[], Any]] = {
        "fig2": lambda: figures.fig2(traces),
        "fig3": lambda: figures.fig3(law),
        "fig5": lambda: figures.fig5(traces),
        "fig6": lambda: figures.fig6(traces),
        "fig7": lambda: figures.fig7(traces),
    }
    for name, figure in draw.items():
        png = BytesIO()
        try:
            # Without the metadata, which names the version of matplotlib.
            figure().savefig(png, format="png", dpi=144, metadata={"Software": None})
        except UndefinedError as reason:
            yield name, reason
        else:
            yield name, png.getvalue()


def _parameters(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [
        ("seed", str(summary["seed"])),
        ("law", summary["law"]),
        ("link", summary["link"]),
        ("dead time", f"{summary['dead_time_us']:g} us"),
        ("version", summary["version"]),
    ]


def _number(value: float) -> str:
    """Four significant digits, or whole numbers from 1000 on."""
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:#.4g}".rstrip(".")


def _with_unit(value: float | None, item: Comparison) -> str:
    return "-" if value is None else f"{_number(value)} {item.published.unit}"


def _paper_cells(item: Comparison) -> tuple[str, str]:
    published = item.published
    paper = "-" if published.value is None else f"{published.value:g}"
    if published.value is not None and published.value >= 1000:
        paper = f"{published.value:.0f}"
    if published.low is None or published.high is None:
        return paper, ""
    return paper, f"{_bound(published.low)} to {_bound(published.high)}"


def _bound(value: float) -> str:
    return f"{value:.0f}" if value >= 1000 else f"{value:g}"


def _headline(comparisons: Sequence[Comparison]) -> str:
    judged = [item for item in comparisons if item.verdict != NOT_JUDGED]
    inside = sum(item.verdict == INSIDE for item in judged)
    return f"{inside} of {len(judged)} judged results lie inside the stated band."


def _comparison_html(item: Comparison) -> str:
    paper, band = _paper_cells(item)
    title = f' title="{escape(item.reason)}"' if item.reason else ""
    mark = {INSIDE: "✓ ", OUTSIDE: "✗ ", MISSING: "? "}.get(item.verdict, "")
    badge = f'<span class="{item.verdict}">{mark}{item.verdict}</span>' if mark else ""
    return (
        f'<tr><th scope="row">{escape(item.published.name)}<small>'
        f"{escape(item.published.where)}</small></th>"
        f"<td{title}>{escape(_with_unit(item.value, item))}</td>"
        f"<td>{escape(paper)}</td><td>{escape(band)}</td><td>{badge}</td></tr>\n"
    )


def _steps_html(table: Mapping[str, Any]) -> str:
    """Rise, overshoot and static error of subjects, by direction and by curve."""
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


def _figure_html(name: str, png: bytes) -> str:
    data, caption = base64.b64encode(png).decode("ascii"), escape(CAPTIONS[name])
    return (
        f'<figure id="{name}"><img alt="{caption}" src="data:image/png;base64,{data}">'
        f"<figcaption><b>Fig. {name[3:]}</b> (simulated). {caption}</figcaption></figure>"
    )


def _list_html(sentences: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(sentence)}</li>" for sentence in sentences) + "</ul>"


def _unavailable_html(unavailable: Mapping[str, str]) -> str:
    if not unavailable:
        return ""
    rows = [f"{key}: {reason}" for key, reason in unavailable.items()]
    return "<h2>Results that do not exist</h2>" + _list_html(rows)


PAGE = """\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>SMARTTAC CAN: the paper's experiments, simulated</title>
<style>
:root { color-scheme: light; --ink: #1f2933; --pale: #5d6a78; --line: #dfe5ea; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 3rem 1.25rem 5rem; max-width: 62rem; color: var(--ink);
  background: #fff; font: 1rem/1.6 system-ui, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; }
h1 { margin: 0 0 .4rem; font-size: 1.9rem; line-height: 1.2; letter-spacing: -.01em; }
h2 { margin: 3rem 0 .8rem; font-size: 1.25rem; }
p, li { max-width: 44rem; }
.lead { margin: 0 0 1.6rem; color: var(--pale); }
dl { display: flex; flex-wrap: wrap; gap: .6rem 2.2rem; margin: 0; padding: .9rem 1.1rem;
  background: #f4f7f9; border-radius: .5rem; }
dt { font-size: .78rem; color: var(--pale); }
dd { margin: 0; font-weight: 600; }
.scroll { overflow-x: auto; }
table { width: 100%; border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .45rem .7rem; border-bottom: 1px solid var(--line); text-align: right;
  white-space: nowrap; vertical-align: top; }
th[scope=row], tr > th:first-child { text-align: left; font-weight: 500; padding-left: 0; }
thead th, .block th { color: var(--pale); font-size: .82rem; font-weight: 600; }
.block:not(:first-child) th { padding-top: 1.5rem; }
small { display: block; color: var(--pale); font-weight: 400; }
.inside, .outside, .missing { display: inline-block; padding: 0 .55rem; border-radius: 1rem;
  font-size: .85rem; font-weight: 600; }
.inside { color: #0b5c49; background: #d9f0e8; }
.outside { color: #8f2412; background: #fbe3dd; }
.missing { color: #6a4a00; background: #fbefcf; }
figure { margin: 0 0 2.6rem; }
img { display: block; width: 100%; height: auto; max-width: 46rem; }
#fig7 img { max-width: 100%; }
figcaption { max-width: 44rem; margin-top: .5rem; color: var(--pale); font-size: .92rem; }
figcaption b { color: var(--ink); }
code { font-size: .85em; overflow-wrap: anywhere; }
@media print { body { padding: 0; } figure, tr { break-inside: avoid; } }
</style>
</head>
<body>
<h1>The paper's experiments, simulated</h1>
<p class="lead">SMARTTAC CAN beside “$paper”. Plate, fingers and sensors are a model; no
number here was measured on hardware.</p>
<dl>$parameters</dl>
<h2>Result and paper</h2>
<p>$verdict Without a band, a figure is shown and not judged: four people are not four presets.</p>
<div class="scroll"><table>
<thead><tr><th scope="col"></th><th scope="col">Result</th><th scope="col">Paper</th>
<th scope="col">Band</th><th scope="col">Verdict</th></tr></thead>
<tbody>
$comparison</tbody></table></div>
<h2>What was fitted and what emerges</h2>
<h3>Fitted</h3>$fitted
<h3>Emerges</h3>$emerges
<h2>Figures</h2>
$figures
<h2>Steps of friction by subject</h2>
<p>The mean curve is the paper's Table I. Noise of the friction coefficient biases the values of
single touches; they are the means over the touches. “std” is the sample standard deviation over
the subjects.</p>
<div class="scroll"><table><tbody>
$steps
</tbody></table></div>
$unavailable
<h2>Traces</h2>
<p>Every number and figure follows from <code>traces.csv</code>, SHA-256 <code>$sha256</code>.</p>
</body>
</html>
"""
"""The page for `string.Template`."""
