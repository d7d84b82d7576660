"""All rules for an EDS at once."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, islice
from typing import Final

from smarttac_can.od import cia
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.eds import load_eds
from smarttac_can.od.file_rules import check_information, check_lists, check_text
from smarttac_can.od.finding import Finding
from smarttac_can.od.ini import EDSError, read_sections
from smarttac_can.od.object_rules import check_objects
from smarttac_can.od.pdo_rules import check_pdos

MAX_FINDINGS: Final = 1000
"""Findings of a file; who has more will not read them."""
_HEADS: Final = {"fileinfo", "deviceinfo", "mandatoryobjects"}


def check_eds(text: str, file_name: str) -> list[Finding]:
    """Check an EDS by CiA 306, and its PDOs and services by CiA 301.

    Parameters
    ----------
    text
        The whole file.
    file_name
        Name it has, without its folder.

    Returns
    -------
    list of Finding
        Errors and warnings in the order of the rules, the first 1000; empty for a file without
        fault.
    """
    findings = list(islice(_findings(text, file_name), MAX_FINDINGS + 1))
    if len(findings) > MAX_FINDINGS:
        findings[-1] = Finding("", f"there are more than {MAX_FINDINGS} findings")
    return findings


def _findings(text: str, file_name: str) -> Iterator[Finding]:
    odd: list[str] = []
    try:
        sections = read_sections(text, odd)
    except EDSError as error:
        yield from check_text(text)
        yield Finding("", str(error))
        return
    if not _HEADS & sections.keys():
        yield Finding("", "it is no EDS: neither [FileInfo], [DeviceInfo] nor [MandatoryObjects]")
        return
    failed = False
    for finding in chain(
        check_text(text),
        (Finding("", line) for line in odd),
        check_information(sections, file_name),
        check_lists(sections),
        check_objects(sections),
    ):
        failed |= finding.error
        yield finding
    try:
        od = load_eds(text, 1)
    except EDSError as error:
        # What made it unreadable was found above; if not, this is all there is to say.
        if not failed:
            yield Finding("", str(error))
        return
    yield from check_pdos(od)
    yield from _check_services(od)


def _check_services(od: ObjectDictionary) -> Iterator[Finding]:
    guarding = {cia.GUARD_TIME, cia.LIFE_TIME_FACTOR} <= od.objects.keys()
    if cia.HEARTBEAT_PRODUCER not in od.objects and not guarding:
        yield Finding("", "the device has neither heartbeat nor node guarding")
    if cia.ERROR_FIELD in od.objects and cia.EMCY_COB_ID not in od.objects:
        message = f"is an error history without EMCY {cia.EMCY_COB_ID:04X}h"
        yield Finding(f"{cia.ERROR_FIELD:04x}", message, error=False)
    produces_sync = od.number(cia.SYNC_COB_ID) & cia.COB_SYNC_PRODUCER
    if produces_sync and cia.SYNC_PERIOD not in od.objects:
        yield Finding("", f"it produces SYNC, but there is no period {cia.SYNC_PERIOD:04X}h")
