"""Forty questions of readers lead to the sentence that answers them."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[1] / "docs" / "dev" / "questions.md"
ROWS = re.findall(
    r"^\| (.+?) \| \[[^\]]+\]\(([^)#]+)(?:#([^)]*))?\) \| (.+) \|$",
    PAGE.read_text(encoding="utf-8"),
    re.MULTILINE,
)
HEADING = re.compile(r"^#+ (.*)$", re.MULTILINE)


def anchors(text: str) -> list[str]:
    """Return the anchors of the headings of a page, as a code host makes them."""
    without_code = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    titles = (re.sub(r"[^\w\- ]", "", title) for title in HEADING.findall(without_code))
    return [title.strip().lower().replace(" ", "-") for title in titles]


def test_each_reader_has_ten() -> None:
    sections = PAGE.read_text(encoding="utf-8").split("\n## ")[1:]
    assert [section.partition("\n")[0] for section in sections] == [
        "Integrator",
        "Student",
        "CI engineer",
        "Author",
    ]
    assert [section.count("\n| ") - 1 for section in sections] == [10] * 4
    assert len({question for question, *_ in ROWS}) == len(ROWS) == 40


@pytest.mark.parametrize(("question", "page", "anchor", "says"), ROWS)
def test_a_question_leads_to_its_answer(question: str, page: str, anchor: str, says: str) -> None:
    text = (PAGE.parent / page).read_text(encoding="utf-8")
    assert question.endswith("?")
    assert not anchor or anchor in anchors(text)
    assert says in " ".join(text.split())
