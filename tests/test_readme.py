"""The README's promises."""

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

from readme_renderer import markdown

import smarttac_can
from smarttac_can.studies.paper.references import TITLE

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"


def block(kind):
    """The one block of code of a kind."""
    (found,) = re.findall(rf"```{kind}\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    return found


def test_readme_script_runs_and_prints_the_shown_output(capsys):
    exec(compile(block("python"), str(README), "exec"), {})
    printed = capsys.readouterr().out
    assert re.fullmatch(r"COF 0\.3[45]\d at \d\.\d\d um\n", printed)
    assert f"```\n\n```\n{printed}```" in README.read_text(encoding="utf-8")


def test_the_test_for_ci_passes(stimulator):
    text = README.read_text(encoding="utf-8")
    (source,) = re.findall(r"\$ cat test_amplitude\.py\n(.*?)\$ pytest", text, re.DOTALL)
    names = {}
    exec(compile(source, str(README), "exec"), names)
    names["test_amplitude_is_reached"](stimulator)


class Addresses(HTMLParser):
    """Targets of the links of a page, or of its images."""

    def __init__(self, text):
        super().__init__()
        self.found = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.found += [value for name, value in attributes if name in {"href", "src"}]


def description():
    """The long description of the package, as its metadata have it."""
    command = [sys.executable, "-m", "hatch_fancy_pypi_readme", str(ROOT / "pyproject.toml")]
    run = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    return run.stdout


def test_readme_on_a_package_index_has_no_dead_link_or_picture():
    text = description()
    shown = markdown.render(text)
    assert shown is not None
    assert all(re.match("https?://|#", address) for address in Addresses(shown).found)
    assert "plate node (33)" in shown, "the drawing in letters"
    assert "Tutorial (`docs/tutorial.md`)" in text
    # The README itself has both, so the test above can fail.
    here = Addresses(markdown.render(README.read_text(encoding="utf-8"))).found
    assert {"docs/tutorial.md", "docs/images/three-parties.svg"} <= set(here)


def test_the_citation_names_this_version_and_the_paper():
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f'\nversion: "{smarttac_can.__version__}"\n' in text
    assert f'title: "{TITLE}"\n' in text
