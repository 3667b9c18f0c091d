"""What the decoder knows before a capture: from the user, a configuration, EDS and DCF files, and the start of the capture."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.communication import NODE_IDS
from pdgw.ds301.objects import Access, CanType, Entry
from pdgw.ds301.values import UNICODE_STRING
from pdgw.gateway.base.errors import GatewayError
from pdgw.profidrive.telegrams import telegram
from pdgw.tools.decoder.capture.pcap import CaptureError
from pdgw.tools.decoder.capture.source import open_source
from pdgw.tools.decoder.frames.canopen.decoder import Dictionary
from pdgw.tools.decoder.frames.canopen.objects import ObjectNames
from pdgw.tools.decoder.frames.engine import Axis, Decoder, Settings, given_axes
from pdgw.tools.decoder.frames.records import CyclicRecord
from pdgw.tools.decoder.view.names import Names

if TYPE_CHECKING:
    from pdgw.gateway.configuration.config import GatewayConfig


def configured_settings(config: GatewayConfig, telegrams: Sequence[int] = ()) -> Settings:
    """Axes and encoders in the order of the frame, with EDS files and ports; ``telegrams`` replace the configured ones.
    ProfidriveError for an unknown telegram."""
    single, known = len(config.can) == 1, config.telegrams
    axes = [
        Axis(
            axis.do_id,
            telegram(telegrams[position] if position < len(telegrams) else axis.telegram, known).number,
            axis.node_id,
            "" if single else str(config.bus_of(axis).channel),
        )
        for position, axis in enumerate(config.objects)
    ]
    cyclic, acyclic = ({port} - {0} for port in (config.transport.cyclic_port, config.transport.acyclic_port))
    return Settings(
        axes,
        dictionary=dictionary_of(_configured_eds(config)),
        cyclic_ports=Settings.cyclic_ports | cyclic,
        acyclic_ports=Settings.acyclic_ports | acyclic,
        telegrams=known,
        families=config.families,
    )


def _configured_eds(config: GatewayConfig) -> dict[int, Path]:
    return {axis.node_id: axis.eds for axis in config.axis if axis.eds and axis.eds.is_file()}


_TYPES = {type_.code: type_ for type_ in CanType}


def _type(code: int | None) -> CanType:
    if code is None:
        return CanType.DOMAIN
    return _TYPES.get(code, CanType.OCTET_STRING if code == UNICODE_STRING else CanType.DOMAIN)


def _entry(variable: Any) -> Entry:
    # A DCF has the configured value of this device, an EDS the default.
    value = variable.value if variable.value is not None else variable.default
    access = variable.access_type if variable.access_type in {a.value for a in Access} else Access.RW.value
    return Entry(
        variable.index, variable.subindex, variable.name, _type(variable.data_type), Access(access), default=value
    )


def entries(dictionary: Any) -> list[Entry]:
    """Every variable of one of canopen's object dictionaries."""
    found = []
    for item in dictionary.values():
        variables = item.values() if hasattr(item, "subindices") else [item]
        found += [_entry(variable) for variable in variables]
    return found


def dictionary_of(files: Mapping[int, Path], default: Path | None = None) -> Dictionary | None:
    """EDS/DCF files by node-ID, and one for all other nodes; each is read when its node is first seen. None without a file."""
    if not files and default is None:
        return None

    @cache
    def of(node_id: int) -> Sequence[Entry] | None:
        path = files.get(node_id, default)
        if path is None:
            return None
        from pdgw.ds301.eds.importer import import_eds  # noqa: PLC0415 (slow to load, and needed with an EDS only)

        try:
            return entries(import_eds(path, node_id).dictionary)
        except CanopenError as error:
            raise GatewayError(f"{path}: {error}") from error

    return of


_PACKETS_MAX: Final = 20_000
"""Number of packets searched for telegrams and the first cyclic frame."""
_CAN_PACKETS_MAX: Final = 2_000
"""Number of packets that are enough without any cyclic frame."""
_NODE_FILE = re.compile(r"(\d{1,3})=(.+)")


@dataclass(frozen=True)
class Knowledge:
    """The user's settings: those of the decoder, every known name, the bit rate of the first bus."""

    settings: Settings
    names: Names
    bitrate: int | None = None


def known_beforehand(
    telegrams: Sequence[int],
    config: Path | None,
    eds: Sequence[str],
    station: str = "",
    embedded: str = "",
) -> Knowledge:
    """From ``--telegram``, ``--config``, ``--eds`` and ``--station``; GatewayError or ProfidriveError for what cannot
    be used.
    ``embedded``: the text of a configuration the capture has in it, used without ``config``.
    """
    settings = Settings(given_axes(telegrams), "--telegram, with the axis number as node-ID")
    files, default = _eds_files(eds)
    bitrate = None
    if config is not None or embedded:
        from pdgw.gateway.configuration.file import load_config, parse_config  # noqa: PLC0415 (loads the whole gateway)

        loaded = (
            load_config(config) if config is not None else parse_config(embedded, "the configuration in the capture")
        )
        settings, files = configured_settings(loaded, telegrams), _configured_eds(loaded) | files
        bitrate = loaded.can[0].bitrate
    dictionary = dictionary_of(files, default)
    dictionaries: list[ObjectNames] = []
    if dictionary is not None:
        # Names do not depend on the node-ID, so one is enough. Report unusable files before the first packet.
        chosen = [*files, *([min(set(range(1, 128)) - set(files))] if default else [])]
        dictionaries = [
            ObjectNames(found, settings.families.known)
            for node_id in chosen
            if (found := dictionary(node_id)) is not None
        ]
    names = Names(dictionaries, settings.telegrams.values(), settings.families)
    return Knowledge(replace(settings, dictionary=dictionary, station=station), names, bitrate)


def _eds_files(texts: Sequence[str]) -> tuple[dict[int, Path], Path | None]:
    files: dict[int, Path] = {}
    default = None
    for text in texts:
        match = _NODE_FILE.fullmatch(text)
        path = Path(match[2] if match else text)
        if not path.is_file():
            raise GatewayError(f"--eds {text}: not a file")
        if match is None:
            default = path
        elif int(match[1]) in NODE_IDS:
            files[int(match[1])] = path
        else:
            raise GatewayError(f"--eds {text}: node-ID {match[1]} is not allowed, expected 1..127")
    return files, default


def look_ahead(file: str, settings: Settings) -> tuple[Settings, int | None, str]:
    """The telegrams from the start of a file, the time of its first cyclic frame, and notes for the user.

    So the first packets are decoded like the last ones, and times count as in ``pdgw timeline``. Damage is reported when it is
    reached.
    """
    decoder = Decoder(replace(settings, axes=(), dictionary=None))
    zero_ns = None
    with contextlib.suppress(CaptureError), open_source(file) as source:
        for number, packet in enumerate(islice(source.packets, _PACKETS_MAX)):
            record = decoder.decode(packet)
            if zero_ns is None and isinstance(record, CyclicRecord):
                zero_ns = record.time_ns
            if decoder.sure or (zero_ns is None and number > _CAN_PACKETS_MAX):
                break
    if settings.axes or not decoder.inferred:
        return settings, zero_ns, ""
    return replace(settings, axes=decoder.inferred), zero_ns, decoder.inference
