"""CANopen objects as parameters 03E8h to EA5Fh, one to one, by SDO."""

from __future__ import annotations

import logging
import struct
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass
from typing import Any, TypeVar

import canopen

from pdgw.ds301.aborts import Abort, CanopenError, SdoAbortedError, SdoCommunicationError
from pdgw.ds301.communication import RESTORE_PARAMETERS
from pdgw.ds301.node.client import NodeClient
from pdgw.ds301.objects import CanType
from pdgw.gateway.objects.drive_object import DriveObject
from pdgw.gateway.parameters.guarded import Check, guard_of
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.codec import MAX_ELEMENTS, Values
from pdgw.profidrive.parameters.description import Description
from pdgw.profidrive.parameters.error_numbers import ParameterErrorNumber as Number
from pdgw.profidrive.parameters.error_numbers import ParameterRefused
from pdgw.profidrive.parameters.model import converted

log = logging.getLogger("gateway")
T = TypeVar("T")

ABORT_ERRORS: dict[int, Number] = {
    Abort.NO_SUCH_OBJECT: Number.IMPERMISSIBLE_PNU,
    Abort.NO_SUCH_SUBINDEX: Number.FAULTY_SUBINDEX,
    Abort.READ_ONLY: Number.VALUE_CANNOT_BE_CHANGED,
    Abort.UNSUPPORTED_ACCESS: Number.VALUE_CANNOT_BE_CHANGED,
    Abort.LENGTH_MISMATCH: Number.INCORRECT_DATA_TYPE,
    Abort.LENGTH_TOO_HIGH: Number.INCORRECT_DATA_TYPE,
    Abort.LENGTH_TOO_LOW: Number.INCORRECT_DATA_TYPE,
    Abort.VALUE_RANGE: Number.LIMIT_EXCEEDED,
    Abort.VALUE_TOO_HIGH: Number.LIMIT_EXCEEDED,
    Abort.VALUE_TOO_LOW: Number.LIMIT_EXCEEDED,
    Abort.MAXIMUM_BELOW_MINIMUM: Number.VALUE_IMPERMISSIBLE,
    Abort.PARAMETER_INCOMPATIBLE: Number.VALUE_IMPERMISSIBLE,
    Abort.INTERNAL_INCOMPATIBLE: Number.VALUE_IMPERMISSIBLE,
    Abort.HARDWARE_ERROR: Number.NOT_EXECUTABLE_IN_STATE,
    Abort.CANNOT_STORE: Number.NOT_EXECUTABLE_IN_STATE,
    Abort.CANNOT_STORE_LOCAL_CONTROL: Number.NOT_EXECUTABLE_IN_STATE,
    Abort.CANNOT_STORE_DEVICE_STATE: Number.NOT_EXECUTABLE_IN_STATE,
    Abort.GENERAL: Number.NOT_EXECUTABLE_IN_STATE,
    Abort.TIMEOUT: Number.NOT_EXECUTABLE_IN_STATE,
}
"""Error numbers for SDO abort codes; any other is the manufacturer's error 65h, with the abort code in the log."""

_FORMATS: dict[int, DataType] = {
    item.code: data_type
    for item, data_type in (
        (CanType.BOOLEAN, DataType.BOOLEAN),
        (CanType.I8, DataType.INTEGER8),
        (CanType.I16, DataType.INTEGER16),
        (CanType.I32, DataType.INTEGER32),
        (CanType.U8, DataType.UNSIGNED8),
        (CanType.U16, DataType.UNSIGNED16),
        (CanType.U32, DataType.UNSIGNED32),
        (CanType.REAL32, DataType.FLOATING_POINT),
        (CanType.VISIBLE_STRING, DataType.VISIBLE_STRING),
        (CanType.OCTET_STRING, DataType.OCTET_STRING),
        (CanType.DOMAIN, DataType.OCTET_STRING),
        (CanType.I64, DataType.OCTET_STRING),
        (CanType.U64, DataType.OCTET_STRING),
    )
}
_BY_LENGTH = {1: DataType.BYTE, 2: DataType.WORD, 4: DataType.DOUBLE_WORD}
_NUMBERS_AS_OCTETS = {CanType.I64.code, CanType.U64.code}
"""Eight bytes have no format of their own: octets, most significant first as everything on this channel."""


@dataclass(frozen=True, slots=True)
class RequestContext:
    """Sender of a parameter request, and the time limit of the answer."""

    host: str | None = None
    """Address of the sender, where its transport has one."""
    deadline: int | None = None
    """Monotonic nanoseconds at which the request has to be answered; None: no limit."""


def error_of_abort(code: int) -> Number:
    """The parameter error number of an SDO abort code."""
    return ABORT_ERRORS.get(code, Number.MANUFACTURER)


def relies_on(owner: DriveObject, index: int, subindex: int) -> bool:
    """Whether the gateway commands this object, has a copy of it, or must not have it changed by others."""
    return owner.owns(index, subindex) or owner.is_reference(index, subindex) or guard_of(index) is not None


class ObjectAccess:
    """SDO access to the node of a drive object, within the time limit of a request.

    In a task; the cyclic exchange never waits for it.
    """

    def __init__(self, owner: DriveObject) -> None:
        self.owner = owner
        self._loop = owner.network.loop

    def run(self, job: Callable[[NodeClient[Any]], T], what: str, deadline: int | None) -> T:
        """A job in the task of the drive's node; ParameterRefused with the error number of whatever went wrong."""
        loop = self._loop
        if deadline is not None and loop.now() >= deadline:
            log.warning("DO %d: %s: the time of this request is over", self.owner.do_id, what)
            raise ParameterRefused(Number.NOT_EXECUTABLE_IN_STATE)
        future = self.owner.client.submit(job)
        try:
            return loop.result(future, None if deadline is None else max(0, deadline - loop.now()))
        except ParameterRefused:
            raise
        except SdoAbortedError as error:
            number = error_of_abort(error.code)
            level = logging.WARNING if number is Number.MANUFACTURER else logging.DEBUG
            log.log(level, "DO %d: %s: %s", self.owner.do_id, what, error)
            raise ParameterRefused(number) from error
        except (TimeoutError, CancelledError) as error:
            future.cancel()
            log.warning("DO %d: %s: no answer in time", self.owner.do_id, what)
            raise ParameterRefused(Number.NOT_EXECUTABLE_IN_STATE) from error
        except (SdoCommunicationError, CanopenError, struct.error, ValueError) as error:
            log.warning("DO %d: %s: %s", self.owner.do_id, what, error)
            raise ParameterRefused(Number.NOT_EXECUTABLE_IN_STATE) from error

    def read(self, index: int, subindex: int, context: RequestContext) -> bytes:
        """SDO upload."""
        return self.run(
            lambda client: client.sdo.read(index, subindex), f"read {index:04X}h/{subindex}", context.deadline
        )

    def write(self, index: int, subindex: int, data: bytes, context: RequestContext) -> None:
        """SDO download; refused if it would change a guarded object of a powered axis. The copies of the gateway follow.

        If a copy cannot be read again, the node is started again: its references are unknown until then. A node that has
        restored its parameters (1011h) is restarted.
        """
        owner = self.owner
        what = f"write {index:04X}h/{subindex}"
        if owner.owns(index, subindex):
            raise ParameterRefused(Number.NO_OPERATION_PRIORITY)
        guard = guard_of(index)
        reads_again = owner.is_reference(index, subindex) or (guard is not None and guard.check is Check.REFERENCES)
        configures = guard is not None and guard.check is Check.CONFIGURATION

        def job(client: NodeClient[Any]) -> None:
            if guard is not None:
                # Check here: the job may have waited, and the axis may have been switched on meanwhile.
                if owner.powered:
                    log.warning("DO %d: %s rejected while the axis is powered: %s", owner.do_id, what, guard.reason)
                    raise ParameterRefused(Number.NOT_EXECUTABLE_IN_STATE)
                then = "; its units and limits are being read" if reads_again else ""
                client.hold(f"a client writes {index:04X}h/{subindex}{then}")
            stale = reads_again
            try:
                try:
                    client.write_for_client(index, subindex, data)
                    client.configuration.client_wrote(index, subindex, data)
                except SdoAbortedError:
                    stale = False  # the device keeps its value
                    raise
                if reads_again:
                    owner.read_references(client)
                    stale = False
            finally:
                # Bringing up the node reads its reference values.
                if guard is not None or stale:
                    client.unhold(check=configures or stale)

        self.run(job, what, context.deadline)
        if index == RESTORE_PARAMETERS:
            owner.reset_node()  # until then it shows what the gateway wrote
        if reads_again:
            owner.references_changed()

    def variable(self, index: int, subindex: int) -> Any:
        """The EDS entry, None where the EDS has none."""
        try:
            item = self.owner.client.sdo.dictionary[index]
            return item if isinstance(item, canopen.objectdictionary.ODVariable) and not subindex else item[subindex]
        except (KeyError, TypeError):
            return None


class ObjectParameter:
    """One object of the drive, for one request."""

    texts: Sequence[str] = ()

    def __init__(self, access: ObjectAccess, index: int, context: RequestContext) -> None:
        self._access = access
        self.index = index
        self._context = context

    def read(self, subindex: int, elements: int) -> Values:
        parts = [self._read_one(subindex + n, elements > 1) for n in range(max(1, elements))]
        first = parts[0]
        if len(parts) == 1:
            return first
        for place, part in enumerate(parts):
            # One format for all elements; a record with different types is read entry by entry.
            if part.format is not first.format or isinstance(part.values, bytes):
                raise ParameterRefused(Number.ADDRESS_IMPERMISSIBLE, subindex + place)
        return Values(first.format, tuple(value for part in parts for value in part.values))

    def _read_one(self, subindex: int, named: bool) -> Values:
        self._check_subindex(subindex, named)
        try:
            data = self._access.read(self.index, subindex, self._context)
        except ParameterRefused as refused:
            raise ParameterRefused(refused.number, subindex if named else None) from refused
        variable = self._access.variable(self.index, subindex)
        data_type = _FORMATS.get(variable.data_type) if variable is not None else None
        if data_type is None or (data_type.char and len(data) != data_type.size):
            data_type = _BY_LENGTH.get(len(data), DataType.OCTET_STRING)
        if data_type.char:
            return Values(data_type, struct.unpack(f"<{data_type.char}", data))
        if len(data) > MAX_ELEMENTS:
            raise ParameterRefused(Number.RESPONSE_TOO_LONG, subindex if named else None)
        if variable is not None and variable.data_type in _NUMBERS_AS_OCTETS:
            data = data[::-1]
        return Values(data_type, data)

    def write(self, subindex: int, elements: int, values: Values) -> None:
        named = elements > 1
        if isinstance(values.values, bytes):
            if named and len(values.values) != elements:
                raise ParameterRefused(Number.NUMBER_OF_VALUES_INCONSISTENT)
            self._write_one(subindex, values, named=False)
            return
        for place, value in enumerate(values.values):
            self._write_one(subindex + place, Values(values.format, (value,)), named=named)

    def _write_one(self, subindex: int, value: Values, *, named: bool) -> None:
        self._check_subindex(subindex, named)
        try:
            self._access.write(self.index, subindex, self._download(subindex, value), self._context)
        except ParameterRefused as refused:
            raise ParameterRefused(refused.number, subindex if named else None) from refused

    def _download(self, subindex: int, value: Values) -> bytes:
        variable = self._access.variable(self.index, subindex)
        data_type = _FORMATS.get(variable.data_type) if variable is not None else None
        typed = value if data_type is None else converted(value, data_type)
        if isinstance(typed.values, bytes):
            if variable is not None and variable.data_type in _NUMBERS_AS_OCTETS:
                return typed.values[::-1]
            return typed.values
        return struct.pack(f"<{typed.format.char}", *typed.values)

    @staticmethod
    def _check_subindex(subindex: int, named: bool) -> None:
        if subindex > 0xFF:
            raise ParameterRefused(Number.FAULTY_SUBINDEX, subindex if named else None)

    def description(self) -> Description:
        """Description from the EDS."""
        item = self._access.owner.client.sdo.dictionary.get(self.index)
        if item is None:
            raise ParameterRefused(Number.DESCRIPTION_NOT_AVAILABLE)
        array = not isinstance(item, canopen.objectdictionary.ODVariable)
        variables = [item[subindex] for subindex in sorted(item) if subindex] if array else [item]
        variable = variables[0] if variables else item[0]
        count = max(item, default=0) + 1 if array else 0
        data_type = _FORMATS.get(variable.data_type)
        if data_type is None:
            raise ParameterRefused(Number.DESCRIPTION_NOT_AVAILABLE)
        writable = any(entry.writable for entry in variables)
        return Description(data_type, item.name, array, count, writable, False, variable.min or 0, variable.max or 0)
