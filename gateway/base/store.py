"""Non-volatile parameters of the gateway, and the units that a person has confirmed.

Non-volatile gateway parameters in a crash-safe file.

Holds what the PLC may change and a power cycle must keep: P922, P925, P927 and the name of each DO, I&M1 to I&M4 of the
device and of each DO. Beside it, what a crash must keep: the drives' own values of objects that the gateway overwrites. The
file is JSON with a version and a checksum, replaced atomically: a crash at any moment leaves the old or the new set. A value is
in force when it is on the disk, not before. A damaged file is set aside and reported, never half used. Left out: drive parameters
(the drive stores its own, 1010h).

Units of an axis that a person has confirmed: written by ``pdgw axis test``, shown by ``pdgw status``.
"""

from __future__ import annotations

import hashlib
import json
import os
import threading
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from pdgw.base.files import read_file
from pdgw.ds301.values import KnownDevice
from pdgw.dsp402.drive.own_values import OwnValues
from pdgw.dsp402.drive_type import Scaling
from pdgw.gateway.base.errors import GatewayError, at_most, problem

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_DIGITS = 8
"""Of the path of a configuration in the name of its store."""
_STORE_MAX = 16 << 20
"""Bytes; the values of an axis take some kilobytes."""
FORMAT_VERSION = 1


class ConfirmedUnits(BaseModel):
    """A person has confirmed the turns of an axis' shaft (axis test): date, drive and units."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    date: Annotated[str, Field(pattern=r"^\d{4}-\d{2}-\d{2}$")]
    serial_number: Annotated[int, Field(ge=0, le=0xFFFF_FFFF)]
    """1018h/4; 0 for a drive without one."""
    velocity_per_rpm: str
    """Velocity units of one rpm, an exact fraction."""
    counts_per_revolution: str = ""
    """Position units of one revolution, an exact fraction; empty where they are not known."""


class IdentificationTexts(BaseModel):
    """I&M1 to I&M4 of the device or of one drive object."""

    model_config = ConfigDict(extra="forbid", validate_assignment=True)

    im1_function: Annotated[str, Field(max_length=32)] = ""
    im1_location: Annotated[str, Field(max_length=22)] = ""
    im2_date: Annotated[str, Field(max_length=16)] = ""
    im3_descriptor: Annotated[str, Field(max_length=54)] = ""
    im4_signature: Annotated[str, Field(max_length=108, pattern="^([0-9a-f]{2})*$")] = ""
    """Hexadecimal."""


class DoParameters(IdentificationTexts):
    """Stored parameters of one drive object; None where the configuration's value still holds."""

    telegram: Annotated[int, Field(ge=1, le=65535)] | None = None
    """P922."""
    sign_of_life_tolerance: Annotated[int, Field(ge=0, le=65535)] = 65535
    """P925; 65535 switches the supervision off: not every PLC has a sign of life."""
    operation_priority: Annotated[int, Field(ge=0, le=1)] = 1
    """P927: 1 = the parameter channel may write."""
    name: Annotated[str, Field(max_length=32)] = ""
    units_witnessed: ConfirmedUnits | None = None
    device: KnownDevice = KnownDevice()
    """The device of its last bring-up."""
    own_values: OwnValues = OwnValues()
    """The drive's own values of the objects that the gateway overwrites, until they were written back."""


class DeviceParameters(IdentificationTexts):
    """The whole set."""

    version: Annotated[int, AfterValidator(at_most(FORMAT_VERSION))] = FORMAT_VERSION
    sys_contact: Annotated[str, Field(max_length=255)] = ""
    sys_name: Annotated[str, Field(max_length=255)] = ""
    sys_location: Annotated[str, Field(max_length=255)] = ""
    """Object of MIB-II, written by SNMP."""
    station_name: Annotated[str, Field(max_length=240)] | None = None
    """Set by DCP; None if the value of the configuration is in force."""
    station_ip: Annotated[str, Field(pattern="^[0-9a-f]{24}$")] | None = None
    """Address, mask and gateway given by DCP, hexadecimal."""
    objects: dict[int, DoParameters] = Field(default_factory=dict)
    """Parameters by DO-ID."""

    @property
    def telegrams(self) -> dict[int, int]:
        """The stored telegrams (P922) by DO-ID."""
        return {do_id: item.telegram for do_id, item in self.objects.items() if item.telegram is not None}

    def drive_object(self, do_id: int) -> DoParameters:
        """The stored parameters of a DO, created on first use."""
        return self.objects.setdefault(do_id, DoParameters())

    def reset_station(self) -> None:
        """Clear what a controller or an engineering tool has set: name, address, I&M1 to I&M4, and the texts of SNMP."""
        self.station_name, self.station_ip = "", None
        self.sys_contact = self.sys_name = self.sys_location = ""
        for place in (self, *self.objects.values()):
            for field in IdentificationTexts.model_fields:
                setattr(place, field, "")


def _sync_folder(folder: Path) -> None:
    """The new name is on the disk, too."""
    try:
        directory = os.open(folder, os.O_RDONLY)
    except PermissionError:
        return  # Windows cannot open folders; its file system ensures the order
    try:
        os.fsync(directory)
    finally:
        os.close(directory)


def state_directory() -> Path | None:
    """Where the stores of configurations are that name none: systemd's StateDirectory, or ``pdgw`` in the XDG state directory.

    None when there is no home directory either.
    """
    given = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    if given:
        return Path(given)
    base = os.environ.get("XDG_STATE_HOME", "")
    if base and Path(base).is_absolute():
        return Path(base) / "pdgw"
    try:
        return Path.home() / ".local" / "state" / "pdgw"
    except RuntimeError:
        return None


def default_store(config: Path) -> Path | None:
    """The store of a configuration file that names none: by its name, and 8 digits of its whole path."""
    directory, whole = state_directory(), config.resolve()
    digits = hashlib.sha256(os.fsencode(whole)).hexdigest()[:_DIGITS]
    return None if directory is None else directory / f"{whole.stem}-{digits}.json"


def _source(path: Path, config: Path | None) -> Path:
    """The file whose values are in force: the store, or for a first start that of an earlier version, which has the file's name
    alone. GatewayError if that one belongs to another file.
    """
    if config is None or path.exists():
        return path
    earlier = path.with_name(f"{path.stem[: -_DIGITS - 1]}.json")
    owner = _owner(earlier)
    if owner not in ("", str(config)):
        raise GatewayError(
            f"parameter store {earlier}: its values belong to {owner}, and {config} has none of its own; set store in it, "
            f"for example store = {json.dumps(str(path))}, or delete {earlier} to use the values of the configuration"
        )
    return path if owner or not earlier.exists() else earlier


def _owner(path: Path) -> str:
    """The configuration file of a default store; empty where the file has none, or is none."""
    try:
        document = json.loads(read_file(path, _STORE_MAX))
    except (OSError, ValueError, RecursionError):
        return ""
    owner = document.get("configuration") if isinstance(document, dict) else None
    return owner if isinstance(owner, str) else ""


def _moved(path: Path, config: Path) -> Iterator[str]:
    """A line for each store of a file of this name that is gone: it may have been moved."""
    for other in sorted(path.parent.glob(f"{path.stem[:-_DIGITS]}{'?' * _DIGITS}.json")):
        owner = _owner(other)
        if owner and not Path(owner).exists():
            yield (
                f"parameter store {other}: its configuration {owner} is gone; if it is {config} now, set store in it: "
                f"store = {json.dumps(str(other))}"
            )


def _make_folder(path: Path) -> None:
    if path.parent == state_directory():
        path.parent.mkdir(parents=True, exist_ok=True)


@contextmanager
def _held(path: Path) -> Iterator[None]:
    """The lock of a store. A folder without write permission has none."""
    try:
        _make_folder(path)
        lock = os.open(path.with_name(path.name + ".lock"), os.O_RDWR | os.O_CREAT, 0o644)
    except OSError:
        yield
        return
    try:
        try:
            if fcntl is not None:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            text = "another gateway or axis test writes it; end that one, or set store to another file"
            raise GatewayError(f"parameter store {path}: {text}") from error
        yield
    finally:
        os.close(lock)


def _checksum(parameters: str) -> str:
    return f"{zlib.crc32(parameters.encode()):08x}"


class _DamagedError(Exception):
    """The file is damaged, or something else than a parameter file."""


def stored_parameters(path: Path | None, config: Path | None = None) -> DeviceParameters:
    """The parameters that a gateway with this store starts with; ``config``: as of ``ParameterStore``. GatewayError when the file
    cannot be read, or belongs to another configuration."""
    try:
        return DeviceParameters() if path is None else _read(_source(path, config), lambda _: None)
    except _DamagedError:
        return DeviceParameters()


def _read(path: Path, report: Callable[[str], None]) -> DeviceParameters:
    try:
        content = read_file(path, _STORE_MAX).decode()
    except FileNotFoundError:
        return DeviceParameters()
    except UnicodeDecodeError:
        raise _DamagedError("not UTF-8 text") from None
    except OSError as error:
        raise GatewayError(f"parameter store {path}: cannot be read: {error.strerror}") from error
    try:
        document = json.loads(content)
        parameters = document["parameters"]
        if document["checksum"] != _checksum(parameters):
            raise _DamagedError("checksum does not match")
        values = json.loads(parameters)
        version = values.get("version", FORMAT_VERSION)
        if isinstance(version, int) and (text := problem(version, FORMAT_VERSION)):
            # Its values may limit a movement: if one is unusable, none is used and the file is kept.
            raise GatewayError(f"parameter store {path}: {text}")
        _remove_positioner(path, values, report)
        return DeviceParameters.model_validate_json(json.dumps(values))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        bad = f"{error.error_count()} bad values" if isinstance(error, ValidationError) else "not a parameter file"
        raise _DamagedError(bad) from error


def _remove_positioner(path: Path, values: dict[str, Any], report: Callable[[str], None]) -> None:
    """Ignore what drafts of 0.9.0 stored of a positioner, with a line for each DO that has it."""
    for do_id, item in values.get("objects", {}).items():
        stored = [item.pop(name, {}) for name in ("positioner", "positioner_blocks")]
        if any(stored):
            report(
                f"parameter store {path}: DO {do_id}: stored positioner values (P2571 to P2623) are ignored: set them"
                f" in [axis.positioner] and [[axis.block]]; parameters {stored[0]}, blocks {stored[1]}"
            )


class ParameterStore:
    """Load and save ``DeviceParameters``; without a path only in memory.

    ``report`` is called with one line about a damaged file and its new place. ``config``: the whole path of the configuration
    file whose default store this is.
    """

    def __init__(self, path: Path | None, report: Callable[[str], None], config: Path | None = None) -> None:
        self.path = path
        self._report = report
        self._config = config
        self._lock = threading.Lock()
        self.parameters = DeviceParameters()
        if path is None:
            return
        source = _source(path, config)
        self.parameters = self._load(source)
        if config is None or path.exists():
            return
        if source == path:
            for line in _moved(path, config):
                report(line)
        elif source.exists():
            self._take(source)

    def _take(self, earlier: Path) -> None:
        """Copy the store of an earlier version, and mark it: another configuration of this name does not get its values."""
        try:
            with _held(earlier):
                _source(self.path or earlier, self._config)  # another one may have been faster
                self.save()
                self._put(earlier, self.parameters)
        except GatewayError as error:
            self._report(str(error))
        else:
            self._report(f"parameter store {earlier}: copied to {self.path}, the store of {self._config} alone")

    @contextmanager
    def held(self) -> Iterator[None]:
        """No other process writes the file meanwhile. GatewayError if one may."""
        if self.path is None:
            yield
            return
        with _held(self.path):
            yield

    def update(self, change: Callable[[DeviceParameters], None]) -> None:
        """Change a copy of the parameters, save it and put it in force, one caller at a time.

        GatewayError when the file system refuses: the old set stays in force then. Returns when the data is on the disk.
        """
        with self._lock:
            changed = self.parameters.model_copy(deep=True)
            change(changed)
            if self.path is not None:
                self._put(self.path, changed)
            self.parameters = changed

    def save(self) -> None:
        """Write the present set; as ``update``."""
        self.update(lambda _: None)

    def _put(self, path: Path, changed: DeviceParameters) -> None:
        parameters = changed.model_dump_json()
        content = {"checksum": _checksum(parameters), "parameters": parameters}
        if self._config is not None:
            content["configuration"] = str(self._config)
        temporary = path.with_name(f"{path.name}.{os.getpid()}.new")
        try:
            _make_folder(path)
            with temporary.open("w", encoding="utf-8") as file:
                file.write(json.dumps(content))
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
            _sync_folder(path.parent)
        except OSError as error:
            raise GatewayError(
                f"parameter store {path}: cannot be written ({error.strerror}); the old values remain valid"
            ) from error

    def _load(self, path: Path) -> DeviceParameters:
        try:
            return _read(path, self._report)
        except _DamagedError as error:
            return self._set_aside(path, str(error))

    def _set_aside(self, path: Path, why: str) -> DeviceParameters:
        number = 1
        while (aside := path.with_name(f"{path.name}.damaged-{number}")).exists():
            number += 1
        try:
            path.replace(aside)
            kept = f"kept as {aside.name}"
        except OSError as error:
            kept = f"cannot be renamed ({error.strerror})"
        self._report(f"parameter store {path}: {why}; {kept}; the values of the configuration are used")
        return DeviceParameters()


NEVER = "units not verified (pdgw axis test)"


def confirmation(date: str, serial_number: int, scaling: Scaling) -> ConfirmedUnits:
    """The stored result of a test: date (``2026-11-22``), serial number of the drive (1018h/4) and its units."""
    counts = scaling.counts_per_revolution
    return ConfirmedUnits(
        date=date,
        serial_number=serial_number,
        velocity_per_rpm=str(scaling.velocity_per_rpm),
        counts_per_revolution="" if counts is None else str(counts),
    )


def units_text(kept: ConfirmedUnits | None, serial_number: int, scaling: Scaling) -> str:
    """For a person: whether the present units of this drive are confirmed."""
    if kept is None:
        return NEVER
    now = confirmation(kept.date, serial_number, scaling)
    if now == kept:
        return f"units verified on {kept.date} (axis test)"
    other = "for other units"
    if now.serial_number != kept.serial_number:
        other = f"for the drive with serial number {kept.serial_number}, this drive has {serial_number}"
    return f"{NEVER}: the axis test of {kept.date} was {other}"
