"""The EDS of a device with every data type, object type and service: the file and its text."""

from pathlib import Path
from typing import Final

RICH_EDS: Final = Path(__file__).parent / "eds" / "rich.eds"
RICH: Final = RICH_EDS.read_text()
