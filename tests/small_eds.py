"""EDS files of a few objects, written after oddities of devices that are not ours."""

from __future__ import annotations

from pathlib import Path

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od.eds import load_eds

NODE_ID = 9

_HEAD = """[FileInfo]
FileName=small.eds
FileVersion=1
FileRevision=1
EDSVersion=4.0
Description=A few objects
CreationTime=09:00AM
CreationDate=01-01-2026
CreatedBy=Test
ModificationTime=09:00AM
ModificationDate=01-01-2026
ModifiedBy=Test
[DeviceInfo]
VendorName=Somebody
VendorNumber=0x9A
ProductName=Small
ProductNumber=1
RevisionNumber=1
OrderCode=0
BaudRate_10=0
BaudRate_20=0
BaudRate_50=0
BaudRate_125=1
BaudRate_250=1
BaudRate_500=1
BaudRate_800=1
BaudRate_1000=1
SimpleBootUpMaster=0
SimpleBootUpSlave=1
Granularity=8
DynamicChannelsSupported=0
GroupMessaging=0
NrOfRXPDO={rx}
NrOfTXPDO={tx}
LSS_Supported=0
{info}[DummyUsage]
Dummy0001=0
Dummy0002=0
Dummy0003=0
Dummy0004=0
Dummy0005=1
Dummy0006=0
Dummy0007=0
"""
_BASE = """[1000]
ParameterName=Device type
ObjectType=7
DataType=7
AccessType=ro
DefaultValue=0
[1001]
ParameterName=Error register
ObjectType=7
DataType=5
AccessType=ro
DefaultValue=0
[1018]
ParameterName=Identity
ObjectType=9
SubNumber=3
[1018sub0]
ParameterName=Number of entries
DataType=5
AccessType=const
DefaultValue=2
[1018sub1]
ParameterName=Vendor-ID
DataType=7
AccessType=ro
DefaultValue=0x9A
[1018sub2]
ParameterName=Product code
DataType=7
AccessType=ro
DefaultValue=1
[1017]
ParameterName=Producer heartbeat time
ObjectType=7
DataType=6
AccessType=rw
DefaultValue=0
"""


def small_eds(objects: str = "", *, info: str = "", rx: int = 0, tx: int = 0) -> str:
    """EDS of the mandatory objects, heartbeat and `objects`, the sections of more of them.

    Parameters
    ----------
    objects
        Sections of objects as in an EDS; a section of a base object replaces that.
    info
        More lines of ``[DeviceInfo]``, each with its line end.
    """
    sections = {}
    for part in (_BASE + objects).split("["):
        if part:
            name, _, body = part.partition("]\n")
            sections[name] = body
    text = _HEAD.format(rx=rx, tx=tx, info=info)
    described = [name for name in sections if len(name) == 4]
    lists = {
        "MandatoryObjects": [name for name in described if name in ("1000", "1001", "1018")],
        "OptionalObjects": [
            name for name in described
            if name not in ("1000", "1001", "1018") and not "2000" <= name < "6000"
        ],
        "ManufacturerObjects": [name for name in described if "2000" <= name < "6000"],
    }  # fmt: skip
    for title, names in lists.items():
        lines = [f"{number}=0x{name}" for number, name in enumerate(names, 1)]
        text += "\n".join((f"[{title}]", f"SupportedObjects={len(names)}", *lines, ""))
    return text + "".join(f"[{name}]\n{body}" for name, body in sections.items())


def entry(section: str, data_type: int, access: str, default: str = "", *more: str) -> str:
    """Section of a VAR or of a sub-index, named after itself."""
    lines = [f"[{section}]", f"ParameterName=Entry {section}", "ObjectType=7"]
    lines += [f"DataType={data_type}", f"AccessType={access}"]
    lines += [f"DefaultValue={default}"] if default else []
    return "\n".join((*lines, *more, ""))


def record(index: str, *entries: str, kind: int = 9) -> str:
    """Sections of a record (`kind` 9) or array (8) and its sub-indices."""
    lines = (f"[{index}]", f"ParameterName=Object {index}", f"ObjectType={kind}")
    return "\n".join((*lines, f"SubNumber={len(entries)}", "")) + "".join(entries)


def written(folder: Path, text: str, name: str = "small.eds") -> Path:
    """File with the text of an EDS."""
    path = folder / name
    path.write_text(text)
    return path


def started(text: str, node_id: int = NODE_ID) -> Device:
    """Device of an EDS, PRE-OPERATIONAL."""
    device = Device(load_eds(text, node_id))
    device.start()
    return device


def read(device: Device, index: int, subindex: int = 0) -> int:
    """Value of an expedited SDO upload; an abort code as a negative number."""
    return _answer(device, bytes((0x40, index & 0xFF, index >> 8, subindex, 0, 0, 0, 0)))


def write(device: Device, index: int, subindex: int, value: int, size: int) -> int:
    """Download a value by SDO; 0, or the abort code as a negative number."""
    command = 0x23 | (4 - size) << 2
    head = bytes((command, index & 0xFF, index >> 8, subindex))
    return _answer(device, head + value.to_bytes(4, "little"))


def _answer(device: Device, request: bytes) -> int:
    (answer,) = device.receive(Frame(0x600 + device.node_id, request))
    assert answer.can_id == 0x580 + device.node_id
    assert answer.data[1:4] == request[1:4]
    command, value = answer.data[0], answer.data[4:]
    if command == 0x80:
        return -int.from_bytes(value, "little")
    return int.from_bytes(value[: 4 - (command >> 2 & 3)], "little") if command & 1 else 0
