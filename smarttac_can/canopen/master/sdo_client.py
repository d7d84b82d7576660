"""An SDO client that shares the server with clients of other processes."""

from __future__ import annotations

from time import sleep
from typing import Final

import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError, SdoError

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master.requests import ABORT, INITIATES, answers
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import AbortCode

_INITIATED: Final = (3, 2)
_PAUSES_S: Final = tuple(2e-3 * attempt for attempt in range(20))
_NO_TRANSFER: Final = bytes((ABORT, *bytes(7)))
_UNDER_WAY: Final = (AbortCode.TOGGLE, AbortCode.TIME_OUT)
"""Codes that abort a transfer under way, and so never answer the request that initiates one."""


class NoAnswerError(SdoCommunicationError):  # type: ignore[misc]  # python-canopen is untyped
    """The SDO server does not answer within the time-out."""


class OtherClientError(SdoError):  # type: ignore[misc]  # python-canopen is untyped
    """Another client interrupts the transfer again and again."""


class SharedSdoClient(canopen.sdo.SdoClient):  # type: ignore[misc]  # python-canopen is untyped
    """Client of a server that other clients use as well; it accepts only its own answers.

    CiA 301 has one client for each SDO, but any number of bench scripts may read. An expedited
    transfer is one request and one answer that names the object, so those of several clients do
    not mix. A segmented transfer, as of a string, ends when another client begins, and is repeated.

    Parameters
    ----------
    network
        Connected network of python-canopen.
    node_id
        Node-ID of the server.
    timeout
        Longest wait for an answer in s.
    """

    def __init__(self, network: canopen.Network, node_id: int, timeout: float) -> None:
        super().__init__(
            cia.SDO_RX_ID + node_id, cia.SDO_TX_ID + node_id, canopen.ObjectDictionary()
        )
        self.network = network
        self.RESPONSE_TIMEOUT = timeout
        self._request = _NO_TRANSFER
        self._answered = False
        self._dropped = False
        network.subscribe(self.tx_cobid, self.on_response)

    def upload(self, index: int, subindex: int) -> bytes:
        """Read the bytes of an entry, and start again if another client interrupts.

        Raises
        ------
        SdoAbortedError
            If the server refuses.
        NoAnswerError
            If the server does not answer.
        OtherClientError
            If another client interrupts the transfer again and again.
        """
        for pause in _PAUSES_S:
            sleep(pause)
            try:
                return bytes(super().upload(index, subindex))
            except NoAnswerError:
                raise
            except SdoCommunicationError:
                continue
            except SdoAbortedError:
                if self._initiating:
                    raise
        raise OtherClientError

    def send_request(self, request: bytes) -> None:
        """Send a request; until the next one only its answer is accepted.

        Raises
        ------
        SdoCommunicationError
            If the request continues a transfer that another client has ended.
        """
        self._request = bytes(request)
        if self._initiating:
            self._answered = self._dropped = False
        self._require_transfer()
        super().send_request(request)

    def read_response(self) -> bytes:
        """Wait for the answer to the last request, and return its 8 bytes.

        Raises
        ------
        NoAnswerError
            If no answer comes within the time-out.
        SdoCommunicationError
            If another client has ended the transfer.
        """
        try:
            response = bytes(super().read_response())
        except SdoCommunicationError as error:
            raise NoAnswerError(*error.args) from error
        self._require_transfer()
        return response

    def on_response(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Handle a frame of the server, unless it answers another client."""
        response = bytes(data)
        if not response:
            return
        # A server has one transfer: it drops this one when another client begins.
        self._dropped |= self._answered and response[0] >> 5 in _INITIATED
        if self._initiating and response[0] == ABORT:
            code = int.from_bytes(response[4:], "little")
            if code in _UNDER_WAY:
                return  # it ends the transfer of another client that reads the same entry
        if answers(Frame(can_id, response), Frame(self.rx_cobid, self._request)):
            self._answered = True
            super().on_response(can_id, data, timestamp)

    @property
    def _initiating(self) -> bool:
        return self._request[0] >> 5 in INITIATES

    def _require_transfer(self) -> None:
        if self._dropped and not self._initiating:
            raise SdoCommunicationError("another client has begun a transfer")
