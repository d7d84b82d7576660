"""Questions of readers lead to the sentence that answers them."""

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


@pytest.mark.parametrize(("question", "page", "anchor", "says"), ROWS)
def test_a_question_leads_to_its_answer(question: str, page: str, anchor: str, says: str) -> None:
    text = (PAGE.parent / page).read_text(encoding="utf-8")
    assert question.endswith("?")
    assert not anchor or anchor in anchors(text)
    assert says in " ".join(text.split())
