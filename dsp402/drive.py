"""The drive client: brings one CiA 402 drive into operation on a bus and keeps watching it.

The cyclic side (``refresh``, ``send``) never blocks; identity check, PDO configuration, references and user SDO jobs
run on the drive's own worker thread.
"""

from __future__ import annotations

import contextlib
import enum
import queue
import struct
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import can
import canopen
from canopen.sdo import SdoAbortedError, SdoCommunicationError

from ds301.aborts import Abort, abort_text
from ds301.emcy import emcy_text
from ds301.errors import CanopenError
from ds301.network import CanNetwork
from ds301.objects import CanType
from ds301.pdo import Pdo
from ds301.simulator import NmtCommand
from dsp402.configuration import PRODUCER_HEARTBEAT, SdoStep, guard_steps, pdo_steps
from dsp402.device import EDS_PATH
from dsp402.errors import Dsp402Error
from dsp402.images import REFERENCE_OBJECTS, DriveCommand, DriveFeedback, References
from dsp402.modes import Mode
from dsp402.pdo import PdoLayout

T = TypeVar("T")
_Job = tuple[Future[Any], Callable[[], None]]
"""What a caller waits for, and the call that answers it."""


class DriveStatus(enum.Enum):
    """Where the drive is on its way to operation."""

    OFFLINE = "offline"
    """Not seen yet, or stopped by us."""
    CONFIGURING = "configuring"
    ONLINE = "online"
    LOST = "lost"
    """Was online; heartbeat or TPDO stopped, or the bus failed. Re-configures by itself, never restarts motion."""
    REFUSED = "refused"
    """Answers, but is the wrong device or does not take the configuration; retried slowly."""


@dataclass(frozen=True, slots=True)
class DriveSettings:
    """Choices for one drive; times in milliseconds."""

    node_id: int
    eds: Path | None = None
    """A user's EDS/DCF; None takes the one in the package."""
    gateway_node_id: int = 127
    heartbeat_ms: int = 100
    """Producer time of both sides; consumers expire after ``heartbeat_factor`` times that."""
    heartbeat_factor: int = 3
    tpdo_event_ms: int = 50
    tpdo_inhibit_us: int = 0
    tpdo_timeout_factor: int = 4
    rpdo_refresh_ms: int = 100
    sdo_timeout_ms: int = 500
    sync: bool = False
    """TPDOs on SYNC (type 1) instead of event-driven (255)."""
    abort_option: int = 3
    """6007h, when the gateway's heartbeat stops: 0 nothing, 1 malfunction, 2 disable voltage, 3 quick stop."""
    allow_unguarded: bool = False
    """Operate a drive that refuses 1016h or 6007h."""
    initial_mode: Mode | None = None
    """6060h to set and confirm (6061h) while configuring, for layouts that do not carry 6060h."""


@dataclass(frozen=True, slots=True)
class DriveEvent:
    """Something the axis must know: ``kind`` is one of status, emcy, boot, refused.

    For ``emcy``: ``code`` the error code, ``register`` the error register, ``data`` the manufacturer bytes.
    """

    kind: str
    text: str
    code: int = 0
    register: int = 0
    data: bytes = b""
    time_ns: int = 0


MS = 1_000_000
_PROFILE = 402
_RETRY_ABSENT_S = 0.5
_RETRY_REFUSED_S = 5.0
_SUPERVISION_S = 0.02
_FIRST_TPDO_S = 1.0
_MODE_CONFIRM_S = 1.0
_ACYCLIC_PDO_NS = 100 * MS


class _Slot:
    """The newest frame of one TPDO: written by the reader thread, taken by the cyclic one."""

    __slots__ = ("data", "errors", "pdo", "taken", "time")

    def __init__(self, pdo: Pdo) -> None:
        self.pdo = pdo
        self.data: bytes | None = None
        self.taken: bytes | None = None
        self.time = 0
        self.errors = 0

    def receive(self, data: bytes, now: int) -> None:
        """Called by the reader thread; an assignment of one reference needs no lock.

        A frame shorter than the mapping is no sign of life: its values would be kept for ever.
        """
        if len(data) < self.pdo.size:
            self.errors += 1
            return
        self.data = data
        self.time = now


class _Sender:
    """What was last sent of one RPDO."""

    __slots__ = ("last", "message", "pdo", "time")

    def __init__(self, pdo: Pdo, node_id: int) -> None:
        self.pdo = pdo
        # One message for all cycles: making one costs more than everything else on the way to the bus.
        self.message = can.Message(arbitration_id=pdo.cob_id(node_id), is_extended_id=False, is_rx=False, dlc=pdo.size)
        self.last = b""
        self.time = 0


def load_eds(path: Path, node_id: int) -> canopen.ObjectDictionary:
    """The object dictionary of a user's EDS/DCF; Dsp402Error names the file and what is wrong with it."""
    try:
        dictionary = canopen.import_od(str(path), node_id)
    except OSError as error:
        raise Dsp402Error("EDS", str(path), f"a readable file ({error.strerror})") from error
    except Exception as error:  # canopen raises whatever configparser and its own conversions meet
        raise Dsp402Error("EDS", str(path), f"a valid EDS or DCF ({error})") from error
    for index in (0x1000, 0x6040, 0x6041):
        if index not in dictionary:
            raise Dsp402Error("EDS", str(path), f"the data sheet of a drive, with object {index:04X}h")
    return dictionary


class DriveClient:
    """One drive. ``on_event`` is called from the worker or reader thread and must only queue."""

    def __init__(
        self,
        network: CanNetwork,
        settings: DriveSettings,
        layout: PdoLayout,
        on_event: Callable[[DriveEvent], None],
    ) -> None:
        self.network = network
        self.settings = settings
        self.layout = layout
        self.on_event = on_event
        self.status = DriveStatus.OFFLINE
        self.status_text = "not started"
        self.feedback = DriveFeedback()
        self.references: References | None = None
        self.homing_method = 0
        self.generation = 0
        """Counts completed configurations, so that the axis sees each restart exactly once."""
        self._old_length_errors = 0
        self.dictionary = load_eds(settings.eds or EDS_PATH, settings.node_id)
        self._node = canopen.RemoteNode(settings.node_id, self.dictionary)
        self._slots: list[_Slot] = []
        self._senders: list[_Sender] = []
        self._acyclic_rpdos: list[_Sender] = []
        self._acyclic_tpdos: list[Pdo] = []
        self._acyclic_read = 0
        self._command: DriveCommand | None = None
        self._sending = False
        self._heartbeat = 0
        self._heartbeat_expected = False
        self._booted = threading.Event()
        self._stopping = threading.Event()
        self._reconfigure = threading.Event()
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._worker = threading.Thread(target=self._run, name=f"drive {settings.node_id}", daemon=True)
        self._apply_times()

    @property
    def length_errors(self) -> int:
        """TPDOs shorter than their mapping, ignored."""
        return self._old_length_errors + sum(slot.errors for slot in self._slots)

    # -- any thread ---------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start the worker: waits for the drive, checks identity, configures, goes operational, supervises."""
        node_id = self.settings.node_id
        network = self.network.canopen
        network.add_node(self._node)
        network.subscribe(0x700 + node_id, self._on_heartbeat)
        network.subscribe(0x80 + node_id, self._on_emcy)
        self._worker.start()

    def submit(self, job: Callable[[DriveClient], T]) -> Future[T]:
        """Run a job with SDO access on the worker thread; never delays the cyclic side.

        The future fails with Dsp402Error at once when the drive is not online.
        """
        future: Future[T] = Future()
        if self.status is not DriveStatus.ONLINE:
            future.set_exception(self._not_online())
            return future

        def run() -> None:
            try:
                result = job(self)
            except Exception as error:  # whatever the job raised belongs to whoever asked for it
                future.set_exception(error)
            else:
                future.set_result(result)

        self._jobs.put((future, run))
        if self.status is not DriveStatus.ONLINE:  # lost since the question above: nobody may come to take the job
            self._fail_jobs()
        return future

    def stop(self) -> None:
        """NMT pre-operational and end of the worker. The axis has stopped the drive before."""
        self._stopping.set()
        self._jobs.put(None)
        self._booted.set()
        if self._worker.is_alive():
            self._worker.join(timeout=2 + self.settings.sdo_timeout_ms / 1000)
        self._sending = False
        self._nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        self.status = DriveStatus.OFFLINE
        self.status_text = "stopped"
        self._fail_jobs()
        self._unsubscribe_pdos()
        network, node_id = self.network.canopen, self.settings.node_id
        if network.nodes.get(node_id) is self._node:
            del network[node_id]
            network.unsubscribe(0x700 + node_id, self._on_heartbeat)
            network.unsubscribe(0x80 + node_id, self._on_emcy)

    def reconfigure(self, layout: PdoLayout, settings: DriveSettings) -> None:
        """Another telegram: map the PDOs anew; the drive must not be in operation."""
        self._sending = False
        self.layout = layout
        self.settings = settings
        self._apply_times()
        self._reconfigure.set()
        self._jobs.put(None)
        self._booted.set()  # a refused drive need not wait for its next try

    # -- cyclic thread ------------------------------------------------------------------------------------------------

    def refresh(self, now: int) -> bool:
        """Cyclic: take the newest TPDO data into ``feedback``; True when online and no TPDO is overdue."""
        fresh = self.status is DriveStatus.ONLINE
        oldest = now - self._timeout_ns
        for slot in self._slots:
            data = slot.data
            if data is not slot.taken:
                slot.taken = data
                if data is not None:
                    slot.pdo.unpack_into(data, self.feedback)
            if slot.time < oldest:
                fresh = False
        return fresh

    def send(self, command: DriveCommand, now: int) -> None:
        """Cyclic: send the RPDOs that changed or are due for refresh, data first, RPDO 1 (Controlword) last."""
        if not self._sending:
            return
        self._command = command
        refresh = self._refresh_ns
        for sender in self._senders:
            data = sender.pdo.pack(command)
            if data != sender.last or now - sender.time >= refresh:
                sender.message.data = bytearray(data)
                if self.network.send_message(sender.message):
                    sender.last = data
                sender.time = now

    # -- worker thread ------------------------------------------------------------------------------------------------

    def read(self, index: int, subindex: int = 0) -> bytes:
        """SDO upload, on the worker thread only; raises canopen's SdoAbortedError / SdoCommunicationError."""
        data: bytes = self._node.sdo.upload(index, subindex)
        return data

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """SDO download, on the worker thread only."""
        self._node.sdo.download(index, subindex, data)

    def read_number(self, index: int, subindex: int = 0, *, signed: bool = False) -> int:
        """An integer object, on the worker thread only."""
        return int.from_bytes(self.read(index, subindex), "little", signed=signed)

    def read_references(self) -> References:
        """Read the reference objects again (worker thread) and keep them in ``references``."""
        defaults = References()
        values: dict[str, int] = {item.name: getattr(defaults, item.name) for item in fields(defaults)}
        for name, index, subindex in REFERENCE_OBJECTS:
            # An object the device does not have leaves the profile's default; every other failure is one.
            if index in self.dictionary:
                values[name] = self._fetch(index, subindex, signed=name.startswith("position"))
        self.references = References(**values)
        return self.references

    def _apply_times(self) -> None:
        settings = self.settings
        self._node.sdo.RESPONSE_TIMEOUT = settings.sdo_timeout_ms / 1000
        self._timeout_ns = settings.tpdo_event_ms * settings.tpdo_timeout_factor * MS
        self._refresh_ns = settings.rpdo_refresh_ms * MS

    def _unsubscribe_pdos(self) -> None:
        for slot in self._slots:
            self.network.unsubscribe_pdo(slot.pdo.cob_id(self.settings.node_id))

    def _fetch(self, index: int, subindex: int = 0, *, signed: bool = False) -> int:
        """As ``read_number``, with an abort that names the object."""
        try:
            return self.read_number(index, subindex, signed=signed)
        except SdoAbortedError as error:
            raise Dsp402Error(
                f"node {self.settings.node_id} object {index:04X}h/{subindex}",
                abort_text(error.code),
                "an object that can be read, as the EDS says",
            ) from error

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._bring_up()
            except SdoCommunicationError as error:
                self._absent(f"no answer from node {self.settings.node_id} ({error})")
            except SdoAbortedError as error:
                self._refuse(f"node {self.settings.node_id} aborted the configuration: {abort_text(error.code)}")
            except CanopenError as error:
                self._refuse(str(error))
            except (struct.error, ValueError) as error:  # canopen unpacks SDO answers unchecked
                self._refuse(f"node {self.settings.node_id} sent an SDO answer that cannot be decoded ({error})")
            else:
                # Brought up for a telegram that is no longer chosen, or restarted meanwhile: once more.
                if self.status is DriveStatus.ONLINE:
                    self._supervise()

    def _not_online(self) -> Dsp402Error:
        return Dsp402Error(f"drive {self.settings.node_id}", self.status.value, "online to be read or written")

    def _set_status(self, status: DriveStatus, text: str) -> None:
        changed = status is not self.status or text != self.status_text
        self.status = status
        self.status_text = text
        if status is not DriveStatus.ONLINE:
            self._fail_jobs()
        if changed:
            kind = "refused" if status is DriveStatus.REFUSED else "status"
            self.on_event(DriveEvent(kind, f"{status.value}: {text}", time_ns=time.monotonic_ns()))

    def _absent(self, text: str) -> None:
        if self.status is not DriveStatus.LOST:
            self._set_status(DriveStatus.OFFLINE, text)
        self._wait(_RETRY_ABSENT_S)

    def _refuse(self, text: str) -> None:
        self._set_status(DriveStatus.REFUSED, text)
        self._wait(_RETRY_REFUSED_S)

    def _wait(self, seconds: float) -> None:
        """Until the node boots, we stop, or the time is over."""
        self._booted.wait(seconds)
        self._booted.clear()

    def _nmt(self, command: NmtCommand) -> None:
        self.network.send(0, bytes((command, self.settings.node_id)))

    def _bring_up(self) -> None:
        self._booted.clear()
        self._reconfigure.clear()
        self._sending = False
        # A node that was stopped answers no SDO before this; a running one stops by its abort option.
        self._nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        device_type = self._fetch(0x1000)
        self._booted.clear()  # a boot-up before this answer is the one we waited for
        self._set_status(DriveStatus.CONFIGURING, "checking identity")
        self._check_identity(device_type)
        self._set_status(DriveStatus.CONFIGURING, "mapping PDOs")
        self._configure_pdos()
        self._configure_guarding()
        if self.settings.initial_mode is not None:
            self._set_mode(self.settings.initial_mode)
        self.read_references()
        if 0x6098 in self.dictionary:
            self.homing_method = self._fetch(0x6098, signed=True)
        for slot in self._slots:
            self.network.subscribe_pdo(slot.pdo.cob_id(self.settings.node_id), slot.receive)
        for pdo in self._acyclic_tpdos:
            self._read_acyclic(pdo)
        for sender in self._acyclic_rpdos:
            for entry in sender.pdo.entries:
                self._fetch(entry.index, entry.subindex)
        self._nmt(NmtCommand.START)
        self._await_tpdos()
        if self._booted.is_set() or self._reconfigure.is_set() or self._stopping.is_set():
            return
        self._heartbeat = time.monotonic_ns()
        self.generation += 1
        self._sending = True
        self._set_status(DriveStatus.ONLINE, f"operational, configuration {self.generation}")

    def _check_identity(self, device_type: int) -> None:
        name = f"node {self.settings.node_id} device type 1000h"
        if device_type & 0xFFFF != _PROFILE:
            raise Dsp402Error(name, f"profile {device_type & 0xFFFF}", "a drive (profile 402)")
        information = self.dictionary.device_information
        for what, subindex, expected in (
            ("vendor-ID 1018h/1", 1, information.vendor_number),
            ("product code 1018h/2", 2, information.product_number),
        ):
            if not expected:
                continue
            found = self._fetch(0x1018, subindex)
            if found != expected:
                raise Dsp402Error(
                    f"node {self.settings.node_id} {what}", f"{found:08X}h", f"{expected:08X}h as the EDS says"
                )

    def _do(self, step: SdoStep) -> None:
        try:
            self.write(step.index, step.subindex, step.data)
        except SdoAbortedError as error:
            if step.optional:
                return
            raise Dsp402Error(
                f"{step.meaning} ({step.index:04X}h/{step.subindex} := {step.value:X}h)",
                abort_text(error.code),
                "a drive that takes it",
            ) from error

    def _configure_pdos(self) -> None:
        settings, node_id = self.settings, self.settings.node_id
        available = [index for index in self.dictionary if self._has_pdo(index)]
        steps = pdo_steps(
            self.layout,
            node_id,
            available,
            sync=settings.sync,
            event_ms=settings.tpdo_event_ms,
            inhibit_us=settings.tpdo_inhibit_us,
        )
        self._unsubscribe_pdos()
        for step in steps:
            self._do(step)
        mapped = [pdo for pdo in self.layout.rpdos if pdo.communication_index in available]
        # Highest number first: RPDO 1 carries the Controlword and must be the last.
        self._senders = [_Sender(pdo, node_id) for pdo in sorted(mapped, key=lambda pdo: -pdo.number)]
        self._old_length_errors = self.length_errors
        self._slots = [_Slot(pdo) for pdo in self.layout.tpdos if pdo.communication_index in available]
        self._acyclic_rpdos = [_Sender(pdo, node_id) for pdo in self.layout.rpdos if pdo not in mapped]
        self._acyclic_tpdos = [p for p in self.layout.tpdos if p.communication_index not in available]
        cyclic = {pdo.number for pdo in mapped} & {slot.pdo.number for slot in self._slots}
        if 1 not in cyclic:
            raise Dsp402Error("PDOs of the drive", "no RPDO 1 or TPDO 1", "at least one of each for the Controlword")

    def _has_pdo(self, index: int) -> bool:
        """Whether ``index`` is the communication parameter of a PDO that exists: in the EDS and in the device."""
        if not (0x1400 <= index < 0x1600 or 0x1800 <= index < 0x1A00):
            return False
        try:
            self.read(index, 1)
        except SdoAbortedError as error:
            if error.code == Abort.NO_SUCH_OBJECT:
                return False
            raise
        return True

    def _configure_guarding(self) -> None:
        settings = self.settings
        limit = settings.heartbeat_ms * settings.heartbeat_factor
        self._heartbeat_expected = settings.heartbeat_ms > 0
        for step in guard_steps(settings.gateway_node_id, limit, settings.heartbeat_ms, settings.abort_option):
            try:
                self._do(step)
                found = self.read(step.index, step.subindex)
                if found != step.data:
                    raise Dsp402Error(step.meaning, found.hex(), f"{step.data.hex()} when read back")
            except (Dsp402Error, SdoAbortedError) as error:
                text = str(error) if isinstance(error, Dsp402Error) else abort_text(error.code)
                if not settings.allow_unguarded:
                    raise Dsp402Error(
                        "guarding of the gateway by the drive",
                        text,
                        "1016h, 1017h and 6007h that can be written (allow_unguarded = true operates it anyway)",
                    ) from error
                if (step.index, step.subindex) == PRODUCER_HEARTBEAT:
                    self._heartbeat_expected = False  # the TPDOs alone tell that the drive lives
                self.on_event(DriveEvent("status", f"not guarded: {text}", time_ns=time.monotonic_ns()))

    def _set_mode(self, mode: Mode) -> None:
        self._do(SdoStep(0x6060, 0, CanType.I8, mode, "mode of operation"))
        deadline = time.monotonic() + _MODE_CONFIRM_S
        while (shown := self._fetch(0x6061, signed=True)) != mode:
            if time.monotonic() > deadline:
                raise Dsp402Error("6061h", shown, f"{mode.value} within {_MODE_CONFIRM_S:g} s of 6060h")
            self._stopping.wait(0.01)

    def _await_tpdos(self) -> None:
        deadline = time.monotonic() + _FIRST_TPDO_S
        while missing := [str(slot.pdo) for slot in self._slots if slot.data is None]:
            if self._stopping.is_set() or self._booted.is_set():
                return
            if time.monotonic() > deadline:
                raise Dsp402Error("TPDOs of the drive", f"none of {', '.join(missing)}", "each within 1 s of NMT start")
            self._stopping.wait(0.005)

    def _supervise(self) -> None:
        """Online: run jobs, watch heartbeat, TPDOs and boot-ups. Returns when the drive has to be brought up anew."""
        limit = self.settings.heartbeat_ms * self.settings.heartbeat_factor * MS
        while not self._stopping.is_set():
            with contextlib.suppress(queue.Empty):
                job = self._jobs.get(timeout=_SUPERVISION_S)
                if job is not None and job[0].set_running_or_notify_cancel():
                    job[1]()
            if self._stopping.is_set():
                return
            now = time.monotonic_ns()
            if self._reconfigure.is_set():
                self._set_status(DriveStatus.CONFIGURING, "telegram changed")
                return
            lost = self._lost(now, limit)
            if lost:
                self._set_status(DriveStatus.LOST, lost)
                self._give_up()
                return
            self._exchange_acyclic(now)

    def _lost(self, now: int, heartbeat_limit: int) -> str:
        if self._booted.is_set():
            return f"node {self.settings.node_id} restarted"
        if now - self._heartbeat > heartbeat_limit and self._heartbeat_expected:
            return f"no heartbeat for {heartbeat_limit // MS} ms"
        overdue = [str(slot.pdo) for slot in self._slots if now - slot.time > self._timeout_ns]
        if overdue:
            return f"no {', '.join(overdue)} for {self._timeout_ns // MS} ms"
        return "" if self.network.healthy else f"CAN bus {self.network.name} is not healthy"

    def _give_up(self) -> None:
        """The axis sends its quick stop meanwhile; a node that does not answer is stopped by NMT."""
        seen = self._heartbeat
        if self._booted.wait(self.settings.heartbeat_ms * 2 / 1000):
            return
        self._sending = False
        if self._heartbeat == seen:
            self._nmt(NmtCommand.STOP)

    def _fail_jobs(self) -> None:
        """Waiting jobs fail at once, because the drive is not online."""
        with contextlib.suppress(queue.Empty):
            while True:
                job = self._jobs.get_nowait()
                if job is not None and job[0].set_running_or_notify_cancel():
                    job[0].set_exception(self._not_online())

    def _exchange_acyclic(self, now: int) -> None:
        """Objects for which the drive has no PDO: written when they change, read every 100 ms."""
        command = self._command
        try:
            for sender in self._acyclic_rpdos:
                if command is not None and (data := sender.pdo.pack(command)) != sender.last:
                    sender.last = data  # a value the drive refuses is told once, not every 20 ms
                    offset = 0
                    for entry in sender.pdo.entries:
                        size = entry.type.bits // 8
                        self.write(entry.index, entry.subindex, data[offset : offset + size])
                        offset += size
            if self._acyclic_tpdos and now - self._acyclic_read >= _ACYCLIC_PDO_NS:
                self._acyclic_read = now
                for pdo in self._acyclic_tpdos:
                    self._read_acyclic(pdo)
        except (SdoAbortedError, SdoCommunicationError, Dsp402Error, struct.error) as error:
            self.on_event(DriveEvent("status", f"object without PDO: {error}", time_ns=time.monotonic_ns()))

    def _read_acyclic(self, pdo: Pdo) -> None:
        for entry in pdo.entries:
            signed = entry.type.char.islower()
            setattr(self.feedback, entry.attribute, self._fetch(entry.index, entry.subindex, signed=signed))

    # -- reader thread ------------------------------------------------------------------------------------------------

    def _on_heartbeat(self, _can_id: int, data: bytes, _timestamp: float) -> None:
        self._heartbeat = time.monotonic_ns()
        if len(data) == 1 and data[0] == 0:
            self._booted.set()
            if self.status is DriveStatus.ONLINE:
                self.on_event(DriveEvent("boot", "boot-up message", time_ns=self._heartbeat))

    def _on_emcy(self, _can_id: int, data: Any, _timestamp: float) -> None:
        if len(data) != 8:
            return
        code = int.from_bytes(data[:2], "little")
        text = f"EMCY {code:04X}h {emcy_text(code)}"
        self.on_event(DriveEvent("emcy", text, code, data[2], bytes(data[3:]), time.monotonic_ns()))
