"""``pdgw decode``: decode data, a capture, a log or a live bus into names, values and bits."""

from __future__ import annotations

import contextlib
import io
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from string import hexdigits
from typing import TYPE_CHECKING, Annotated

import typer

from pdgw.base.durations import SECOND
from pdgw.base.phrases import counted
from pdgw.gateway.base.errors import GatewayError
from pdgw.profidrive.errors import ProfidriveError
from pdgw.tools.options import Station

if TYPE_CHECKING:
    from pdgw.tools.decoder.capture.source import Source
    from pdgw.tools.decoder.export.archive import ArchiveOptions
    from pdgw.tools.decoder.export.writers import Writer
    from pdgw.tools.decoder.frames.engine import CanPacket, Decoder, Packet
    from pdgw.tools.decoder.view.filter import Selection

_LATE_NS = 2 * SECOND
"""Greatest disorder of packets in a file. Reading stops when a packet is later than ``--to`` by more than this."""


def decode(
    files: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[FILE]...",
            help="Capture or log: pcap, pcapng, candump, .asc, .blf, .trc ...; - is stdin.",
            show_default=False,
        ),
    ] = None,
    hex_text: Annotated[
        str | None,
        typer.Option("--hex", help="Telegram words, C_SDU, whole frame, parameter request or response; - reads stdin."),
    ] = None,
    live: Annotated[
        str | None,
        typer.Option(
            metavar="SOURCE", help="Listen on a network interface (root) or on a python-can bus, like socketcan:can0."
        ),
    ] = None,
    telegram: Annotated[
        list[int] | None, typer.Option(help="Telegram of the data; repeat for each axis (default: inferred).")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="The gateway's configuration: axes, nodes, ports, EDS.")] = None,
    eds: Annotated[list[str] | None, typer.Option(help="EDS or DCF of the nodes, or NODE=FILE.")] = None,
    station: Station = "",
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object for each packet.")] = False,
    csv: Annotated[
        str | None, typer.Option(help="CSV table with these columns, for example STW1,NSOLL_A,Statusword.")
    ] = None,
    parquet: Annotated[
        Path | None,
        typer.Option(help="Table of --signal: a .parquet file, or a folder for many captures."),
    ] = None,
    stats: Annotated[
        bool, typer.Option("--stats", help="Show rates, jitter, counter gaps and bus load instead.")
    ] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Show the full tree with every bit.")] = False,
    changes_only: Annotated[bool, typer.Option("--changes-only", help="Show only changes.")] = False,
    filter_text: Annotated[
        str | None, typer.Option("--filter", help="Expression, like 'stw1.on == 0 and axis == 1'.")
    ] = None,
    begin: Annotated[
        str | None, typer.Option("--from", help="Seconds since the first cyclic frame, or an ISO time.")
    ] = None,
    end: Annotated[str | None, typer.Option("--to", help="As --from.")] = None,
    signal: Annotated[
        list[str] | None, typer.Option(help="Only these signals, objects or fields, comma separated.")
    ] = None,
) -> None:
    """Decode hexadecimal data (--hex), a capture of either bus, or the live frames of a bus."""
    from pdgw.ds301.bus.load import DEFAULT_BITRATE
    from pdgw.tools.decoder.capture.knowledge import known_beforehand, look_ahead
    from pdgw.tools.decoder.capture.pcap import configuration_in
    from pdgw.tools.decoder.export.archive import ArchiveOptions, is_data_set
    from pdgw.tools.decoder.export.writers import CsvWriter, JsonWriter, ParquetWriter, StatsWriter, TextWriter
    from pdgw.tools.decoder.frames.engine import Decoder
    from pdgw.tools.decoder.view.filter import Changes, Filter, Selection

    if sum(source is not None for source in (files or None, hex_text, live)) != 1:
        raise GatewayError("give one of: files (or -), --hex, --live")
    packets: list[Packet] = []
    if hex_text is not None:
        packets, telegram = _hex_packets(sys.stdin.read() if hex_text == "-" else hex_text, telegram or [])
    signals = [name.strip() for text in signal or [] for name in text.split(",")]
    if files and parquet is not None and is_data_set(parquet):
        options = ArchiveOptions(tuple(signals), tuple(telegram or ()), config, tuple(eds or ()), filter_text)
        refused = {
            "--csv": csv,
            "--stats": stats,
            "--json": as_json,
            "--from": begin,
            "--to": end,
        }
        for name, value in refused.items():
            if value:
                raise GatewayError(f"{name}: not allowed with --parquet FOLDER, which is a table of whole files")
        _write_data_set(files, parquet, options)
        return
    file = _only(files) if files else None
    embedded = configuration_in(Path(file)) if file is not None and config is None and not telegram else ""
    if embedded:
        _print_notices([f"the configuration of the gateway is read from {file}"])
    known = known_beforehand(telegram or [], config, eds or [], station, embedded)
    selection = Selection(
        signals=[known.names.split(name)[0] for name in signals],
        filter=Filter(filter_text, known.names) if filter_text is not None else None,
        changes=Changes() if changes_only else None,
    )
    writers: list[Writer] = []
    if parquet is not None:
        writers.append(ParquetWriter(parquet, signals, known.names))
    if csv is not None:
        writers.append(CsvWriter(sys.stdout, [name.strip() for name in csv.split(",")], known.names))
    elif stats:
        writers.append(StatsWriter(sys.stdout, known.bitrate or DEFAULT_BITRATE, as_json=as_json))
    elif as_json:
        writers.append(JsonWriter(sys.stdout))
    elif not writers or verbose:
        writers.append(TextWriter(sys.stdout, colour=_colours(), verbose=verbose))
    settings, zero_ns = known.settings, None
    if file not in {None, "-"}:
        settings, zero_ns, inference = look_ahead(str(file), settings)
        if inference:
            _print_notices([inference])
    with _open(file, live, packets) as source:
        if source.size is None:
            _line_buffered()
        _run(source, Decoder(settings), selection, writers, (begin, end), zero_ns)


def _only(files: Sequence[str]) -> str:
    """The only file; GatewayError for several, and for data in its place."""
    if not Path(files[0]).exists() and set("".join(files)) <= set(hexdigits):
        raise GatewayError(f"{files[0]}: not a file; hexadecimal data: pdgw decode --hex '{' '.join(files)}'")
    if len(files) > 1 or Path(files[0]).is_dir():
        raise GatewayError("several files need --parquet FOLDER and --signal; or give one file")
    return files[0]


def _hex_packets(text: str, telegrams: list[int]) -> tuple[list[Packet], list[int]]:
    """The packets that carry the data and the telegrams of their axes: telegram words can be setpoints and actual values."""
    from pdgw.profidrive.telegrams import Direction
    from pdgw.tools.decoder.frames.recognise import packet_of, parse_hex, standard_request, swapped_words

    data = parse_hex(text)
    found: list[tuple[Packet, list[int]]] = []
    refusals: list[ProfidriveError] = []
    for direction in Direction:
        try:
            packet, chosen = packet_of(data, telegrams, direction)
        except ProfidriveError as error:
            refusals.append(error)
            continue
        if not found and len(chosen) == 1 and (hint := swapped_words(data, chosen[0], direction)):
            _print_notices([hint])
        if not found and (standard := standard_request(data)) and packet.data.endswith(standard):
            _print_notices(
                [f"the bytes of its words are swapped, as in the manufacturer's guide; decoded as {standard.hex(' ')}"]
            )
        found.append((packet, list(chosen)))
    if not found:
        raise refusals[0]
    _, first = found[0]
    packets = dict.fromkeys(packet for packet, chosen in found if chosen == first)
    return [packet._replace(number=number) for number, packet in enumerate(packets, 1)], first


def _write_data_set(files: Sequence[str], root: Path, options: ArchiveOptions) -> None:
    """Decode the files and print a result for each. The exit status is 1 when a file is damaged."""
    from pdgw.tools.decoder.export.archive import captures_of, write_data_set
    from pdgw.tools.recording.progress import with_progress_of

    captures = captures_of(files)
    begin = time.monotonic()
    parts = []
    for part in with_progress_of(write_data_set(captures, root, options), "decoding", len(captures)):
        parts.append(part)
        for notice in part.notices:
            sys.stderr.write(f"note: {part.file}: {notice}\n")
        if part.error:
            sys.stderr.write(f"error: {part.error}\n")
    damaged = sum(bool(part.error) for part in parts)
    rows = sum(part.rows for part in parts)
    bad = f", {damaged} damaged" if damaged else ""
    typer.echo(
        f"{root}: {counted(rows, 'row')} from {counted(len(parts), 'file')}{bad} in {time.monotonic() - begin:.1f} s"
    )
    if damaged:
        raise typer.Exit(1)


def _open(file: str | None, live: str | None, packets: Sequence[Packet]) -> Source:
    from pdgw.tools.decoder.capture.live import open_can, open_interface
    from pdgw.tools.decoder.capture.source import Source, open_source

    if packets:
        return Source("--hex", iter(packets))
    if live is not None:
        return open_can(live) if ":" in live else open_interface(live)
    return open_source(file or "-")


def _line_buffered() -> None:
    """Show live output at once, also when it goes to a pipe."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(line_buffering=True)


def _colours() -> bool:
    return sys.stdout.isatty() and "NO_COLOR" not in os.environ


# -- the loop ---------------------------------------------------------------------------------------------------------


def _run(
    source: Source,
    decoder: Decoder,
    selection: Selection,
    writers: Sequence[Writer],
    limits: tuple[str | None, str | None],
    zero_ns: int | None,
) -> None:
    """Decode until the end of the input, Ctrl-C or a damaged packet. The writers are closed in each case."""
    from pdgw.tools.recording.progress import with_progress

    try:
        try:
            packets = with_progress(source.packets, Path(source.name).name, source.size, source.position)
            with contextlib.suppress(KeyboardInterrupt):
                _loop(packets, decoder, selection, writers, limits, zero_ns)
            _print_notices(source.notices)
        finally:
            for writer in writers:
                writer.finish()
    except BrokenPipeError:
        # The reader has closed the pipe: do not flush at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _loop(
    packets: Iterator[Packet | CanPacket],
    decoder: Decoder,
    selection: Selection,
    writers: Sequence[Writer],
    limits: tuple[str | None, str | None],
    zero_ns: int | None,
) -> None:
    from pdgw.tools.decoder.capture.live import moment
    from pdgw.tools.decoder.export.writers import TextWriter

    first = next(packets, None)
    if first is None:
        return
    if zero_ns is None:
        zero_ns = first.time_ns
    selection.begin_ns = moment(limits[0], "--from", zero_ns) if limits[0] is not None else None
    selection.end_ns = moment(limits[1], "--to", zero_ns) if limits[1] is not None else None
    stop_ns = None if selection.end_ns is None else selection.end_ns + _LATE_NS
    everything = selection.everything
    for writer in writers:
        if isinstance(writer, TextWriter):
            writer.zero_ns = zero_ns
    takes = [writer.take for writer in writers]
    decode_one = decoder.decode
    notices = decoder.notices

    def one(packet: Packet | CanPacket) -> None:
        record = decode_one(packet)
        if notices:
            _print_notices(notices)
        units = None
        if not everything:
            units = selection.select(record)
            if units is None:
                return
        for take in takes:
            take(record, units)

    one(first)
    for packet in packets:
        if stop_ns is not None and packet.time_ns > stop_ns:
            return
        one(packet)


def _print_notices(notices: list[str]) -> None:
    for notice in notices:
        sys.stderr.write(f"note: {notice}\n")
    notices.clear()
