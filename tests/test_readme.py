"""The README's promises."""

import re
from pathlib import Path

README = Path(__file__).parents[1] / "README.md"


def test_the_bench_script_works_as_printed(capsys):
    scripts = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert len(scripts) == 1
    exec(compile(scripts[0], str(README), "exec"), {})
    printed = re.fullmatch(r"COF (\d\.\d{3}) at (\d\.\d\d) um\n", capsys.readouterr().out)
    assert printed is not None
    assert abs(float(printed[1]) - 0.35) < 0.01
    assert 0.5 < float(printed[2]) < 3.0
