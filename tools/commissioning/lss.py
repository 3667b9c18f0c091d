"""Node-ID and bit rate of one device by LSS, with the blocking master of python canopen.

Source: CiA 305. At most one device is in configuration state: it is selected by its whole identity (40h to 43h). Switching all of
them to configuration (04h 01h) is never sent: a node-ID would be given to each.
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final, TypeVar

import canopen
from canopen.lss import LssError

from pdgw.ds301.communication import IDENTITY, LSS_BIT_TIMINGS, NMT, NODE_IDS, NmtCommand
from pdgw.gateway.base.errors import GatewayError

Identity = tuple[int, int, int, int]
"""Vendor-ID, product code, revision and serial number (1018h)."""
_SCAN_S: Final = 0.05
"""Time for an answer of a fastscan: each bit that is 1 costs it."""
_ANSWER_S: Final = 0.5
_STORE_S: Final = 5.0
_BOOT_TRIES: Final = 10
"""Reads of 1018h until the device has booted with its new node-ID, each with the time of python canopen for an answer."""
_MOST: Final = len(NODE_IDS)

T = TypeVar("T")


def identity_text(identity: Identity) -> str:
    """For people."""
    vendor, product, revision, serial = identity
    return (
        f"vendor-ID {vendor:08X}h, product code {product:08X}h, revision {revision:08X}h, serial number {serial:08X}h"
    )


class LssBus:
    """LSS on a bus. ``opened`` leaves all devices in waiting state at its end, also after an error or Ctrl-C."""

    def __init__(self, network: canopen.Network) -> None:
        self._network = network
        self._lss = network.lss

    @contextmanager
    def opened(self) -> Iterator[None]:
        """Devices may be switched to configuration state until the end."""
        try:
            self._wait()
            yield
        finally:
            self._wait()

    def _wait(self) -> None:
        """All devices in waiting state."""
        self._lss.send_switch_state_global(self._lss.WAITING_STATE)

    def non_configured(self) -> list[Identity]:
        """The devices without a node-ID, each found by a fastscan; they are in waiting state again."""
        self._lss.RESPONSE_TIMEOUT = _SCAN_S
        self._lss.send_identify_non_configured_remote_slave()
        return self._scan() if self._answered(_ANSWER_S) else []

    def _answered(self, timeout_s: float) -> bool:
        """Whether an answer comes in time. Those of further devices are taken, too: they must not count for the next request."""
        answered = False
        with suppress(queue.Empty):
            while self._lss.responses.get(block=True, timeout=_SCAN_S if answered else timeout_s):
                answered = True
        return answered

    def _scan(self) -> list[Identity]:
        found: list[Identity] = []
        while len(found) < _MOST:
            answered, identity = self._lss.fast_scan()
            if not answered:
                break
            found.append((identity[0], identity[1], identity[2], identity[3]))
        self._wait()
        return found

    def assign(self, identity: Identity, node_id: int, old: int | None, bitrate: int | None) -> str:
        """Give the device with this identity its node-ID, and store it.

        ``old``: its node-ID until now; None: it has none. ``bitrate``: it has from its next start. Returns why it is not stored;
        empty if it is. GatewayError if the device does not take it.
        """
        self._lss.RESPONSE_TIMEOUT = _ANSWER_S
        silent = "no answer to its identity: it has no LSS, or is in operation"
        self._do(silent, self._lss.send_switch_state_selective, *identity)
        if bitrate is not None:
            self._do(f"bit rate {bitrate} is refused", self._lss.configure_bit_timing, LSS_BIT_TIMINGS[bitrate])
        self._do(f"node-ID {node_id} is refused", self._lss.configure_node_id, node_id)
        failed = ""
        self._lss.RESPONSE_TIMEOUT = _STORE_S
        try:
            self._lss.store_configuration()
        except LssError as error:
            failed = f"not stored ({error}): the device loses it at power-off"
        self._wait()
        if old is not None:
            self._network.send_message(NMT, bytes((NmtCommand.RESET_COMMUNICATION, old)))
        self._prove(identity, node_id)
        return failed

    def _do(self, failure: str, service: Callable[..., T], *values: object) -> T:
        try:
            return service(*values)
        except LssError as error:
            raise GatewayError(f"LSS: {failure} ({error}); the device keeps what it had") from error

    def _prove(self, identity: Identity, node_id: int) -> None:
        """Read 1018h at the new node-ID."""
        sdo = self._network.add_node(node_id).sdo
        for _ in range(_BOOT_TRIES):
            with suppress(canopen.SdoCommunicationError):
                first = int.from_bytes(sdo.upload(IDENTITY, 1), "little")
                last = int.from_bytes(sdo.upload(IDENTITY, 4), "little")
                if (first, last) == (identity[0], identity[3]):
                    return
                raise GatewayError(
                    f"node {node_id} is another device: vendor-ID {first:08X}h, serial number {last:08X}h in 1018h"
                )
        raise GatewayError(
            f"no answer from node {node_id}: some devices take a new node-ID only after they were switched off and on"
        )
