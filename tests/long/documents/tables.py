"""Documents generated from the declarations: tables, habits of devices, power table, words of the PLC simulator.

``python -m tests.long.documents.tables`` (``make docs``) writes the files. A test fails when one is out of date.
"""

from __future__ import annotations

import ast
import enum
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from pdgw.ds301.aborts import ABORT_TEXTS, abort_text
from pdgw.dsp402.acting import ACTING
from pdgw.dsp402.modes import Mode
from pdgw.dsp402.objects import DRIVE_OBJECTS
from pdgw.dsp402.pdo.layouts import LAYOUTS, with_objects
from pdgw.dsp402.states import COMMAND_TRANSITIONS, STATUS_PATTERNS
from pdgw.dsp406.faults import ENCODER_EMCY
from pdgw.dsp406.kinds import Alarm, EncoderType, Operating, Warnings
from pdgw.dsp406.objects import PROFILE, ProfileObject
from pdgw.gateway.axis.demand_report import PowerWish
from pdgw.gateway.axis.orders import LEAVE_TEXTS, LINE_TEXTS, ORDERS
from pdgw.gateway.axis.power_states import CONTROLWORDS, Action, Drive, Phase
from pdgw.gateway.axis.power_table import ANY_DRIVE, ANY_PHASE, ANY_WISH, ORDER_ROWS, ROWS
from pdgw.gateway.base.fault_numbers import FaultNumber
from pdgw.gateway.base.reasons import Reason
from pdgw.gateway.base.step_text import remedy_text
from pdgw.gateway.links.profinet.diagnosis import MESSAGE_CLASSES
from pdgw.gateway.motion.requests import Command
from pdgw.gateway.motion.states import MDI_TRANSITIONS, Event, State, Transition
from pdgw.gateway.motion.states import TRANSITIONS as POSITIONER_TRANSITIONS
from pdgw.gateway.parameters.guarded import GUARDED
from pdgw.gateway.parameters.objects import error_of_abort
from pdgw.peers.drive.model.shapes import SHAPES
from pdgw.peers.drive.objects import DRIVE_FAULTS, FAMILY, FAMILY_MODES, HOMING_METHODS, OBJECTS
from pdgw.peers.encoder.outputs import AreaState
from pdgw.profidrive.datatypes import UNVERIFIED, DataType
from pdgw.profidrive.parameters.catalogue import PARAMETERS
from pdgw.profidrive.parameters.error_numbers import ERROR_TEXTS
from pdgw.profidrive.sensor_states import SENSOR_ERROR_TEXTS, SENSOR_STATUS, TRANSITIONS
from pdgw.profidrive.signals import CATALOGUE, POSITIONER_FORMS, Signal
from pdgw.profidrive.telegrams import TELEGRAMS, ApplicationClass, Telegram, TelegramHalf
from pdgw.profidrive.words import Bit, Confidence
from pdgw.profinet.blocks.alarm import MESSAGE_CLASS_TEXTS
from pdgw.profinet.model import TELEGRAM_IDENT, TELEGRAM_SUBSLOT
from tests.long.bench import counting
from tests.long.documents import habits, package_picture, supervisions
from tests.long.documents.simulator_steps import generate_steps
from tests.support.documents import order_times
from tests.support.documents.parts import table, write_part
from tests.support.documents.profile_numbers import word_positions
from tests.support.documents.sources import ROOMS

_ROOT = Path(__file__).parents[3]
_DOCS = _ROOT / "docs"
PATH = _DOCS / "tables.md"


def _half(half: TelegramHalf) -> str:
    parts = []
    for signal, word in zip(half.signals, word_positions(half), strict=True):
        last = word + signal.words - 1
        parts.append(f"{word}{f'-{last}' if last > word else ''} {signal.name}")
    return ", ".join(parts)


def _bytes(half: TelegramHalf) -> str:
    """Offset of each signal in the data of a submodule, and the total length."""
    offset, parts = 0, []
    for signal in half.signals:
        parts.append(f"{offset} {signal.name}")
        offset += signal.type.size
    return f"{', '.join(parts)}; {offset} in all"


def _marked(text: str, confidence: Confidence) -> str:
    """Mark a text that fewer than two public sources confirm."""
    return f"{text} ({confidence.text})" if confidence.text else text


def _meaning(bit: Bit) -> str:
    return _marked(bit.meaning, bit.confidence)


def _classes(telegram: Telegram) -> str:
    return ", ".join(str(item.value) for item in telegram.classes)


def _signal_row(signal: Signal) -> Sequence[object]:
    description = _marked(signal.description, signal.confidence)
    return signal.name, signal.number or "", signal.type.name, signal.unit, description


def _bits(signal: Signal) -> str:
    rows = []
    positioning = {bit.position: bit for bit in signal.positioning_bits}
    for bit in signal.bits:
        other = positioning.get(bit.position)
        span = f"{bit.position}-{bit.position + bit.width - 1}" if bit.width > 1 else f"{bit.position}"
        rows.append(
            (
                span if " " in signal.name else f"{signal.name}.{span}",
                bit.name,
                _meaning(bit),
                other.name if other else "",
                _meaning(other) if other else "",
            )
        )
    if positioning:
        return table(("bit", "name", "meaning of 1", "positioning", "meaning of 1 in positioning"), rows)
    return table(("bit", "name", "meaning of 1"), (row[:3] for row in rows))


def _pattern(mask: int, value: int) -> str:
    bits = "".join("x" if not mask >> n & 1 else str(value >> n & 1) for n in range(7, -1, -1))
    return f"xxxx xxxx {bits[:4]} {bits[4:]}"


def _encoder_types(row: ProfileObject) -> str:
    if len(row.types) == len(EncoderType):
        return "all types"
    types = ", ".join(str(type_.value) for type_ in sorted(row.types))
    return f"types {types}" + (f", others {row.elsewhere.value}" if row.elsewhere.value else "")


def _positioner_telegrams(signal: Signal | None = None) -> str:
    """The telegrams with a signal in the positioner's form; without a signal, all of these telegrams."""
    wanted = set(POSITIONER_FORMS.values()) if signal is None else {signal}
    numbers = [n for n, t in TELEGRAMS.items() if wanted & {*t.setpoints.signals, *t.actuals.signals}]
    return ", ".join(map(str, numbers))


_SIGNAL_HEADER = ("signal", "number", "type", "unit", "meaning")
_CLASSES = ", ".join(f"{item.value} {item.name.lower()}" for item in ApplicationClass)
_CONFIDENCE = f"""\
Class: application class of the profile ({_CLASSES}). Telegrams, signals and bits marked "{Confidence.ONE_SOURCE.text}" rest on
a single public source; "{Confidence.UNVERIFIED.text}" ones are a choice of this project, for which no public source was
found. The others have two sources, or are the manufacturer's.
"""


_POSITIONER = """\
One row of the state that runs is taken in a step: the first whose event is there. Edges of STW1.6 are latched with the data of
their frame; see docs/motion.md.
"""


_MDI = """\
Telegram 9 has MDI tasks and homing alone. Homing interrupts a task, and lasts until STW1.11 = 0.
"""


def _positioner(transitions: Mapping[State, Sequence[Transition]]) -> str:
    """The states of a positioner as a table and a Mermaid diagram, without the end of operation, which leaves every state."""
    rows = [(state, row) for state, rows in transitions.items() for row in rows]
    names = {state: state.name.title().replace("_", "") for state in transitions}
    lines = ["```mermaid", "stateDiagram-v2"]
    lines += [f"    {name}: {state.value}" for state, name in names.items()]
    lines += [
        f"    {names[state]} --> {names[row.target]}: {row.event.value.replace(':', ',')}"
        for state, row in rows
        if row.event is not Event.NOT_OPERATING and row.target is not state
    ]
    cells = (
        (
            state.value,
            row.event.value,
            row.target.value,
            row.action.value,
            ", ".join(command.name for command in Command if command & row.lost),
        )
        for state, row in rows
    )
    return (
        table(("state", "event", "next state", "what is done", "bits without effect from then on"), cells)
        + "\n"
        + "\n".join([*lines, "```"])
        + "\n"
    )


def _packages() -> Iterable[Sequence[object]]:
    """Each package with the first line of its docstring."""
    for path in sorted(path.parent for room in ROOMS for path in (_ROOT / room).rglob("__init__.py")):
        text = ast.get_docstring(ast.parse((path / "__init__.py").read_text(encoding="utf-8"))) or ""
        yield f"`{path.relative_to(_ROOT).as_posix()}/`", text.partition("\n")[0].replace("``", "`")


def generate() -> str:
    """Generate the document of the tables."""
    out = [
        "# Reference tables\n",
        "For engineers who know what they search for. Generated from the declarations by `make docs`; do not edit.\n",
        "## Telegrams\n",
        table(
            ("telegram", "mode", "class", "setpoints (word, signal)", "actual values (word, signal)"),
            (
                (
                    _marked(f"{t.number}", t.confidence),
                    t.mode.value,
                    _classes(t),
                    _half(t.setpoints),
                    _half(t.actuals),
                )
                for t in TELEGRAMS.values()
            ),
        ),
        _CONFIDENCE,
        "## PROFINET submodules\n",
        f"Byte offsets in the data of subslot {TELEGRAM_SUBSLOT} of a drive object's slot, big-endian. "
        "IOPS follows, it is the driver's business.\n",
        table(
            ("telegram", "identification", "output (to the drive)", "input (from the drive)"),
            ((n, f"{TELEGRAM_IDENT + n:08X}h", _bytes(t.setpoints), _bytes(t.actuals)) for n, t in TELEGRAMS.items()),
        ),
        "## Signals\n",
        table(_SIGNAL_HEADER, map(_signal_row, CATALOGUE)),
        f"In telegrams {_positioner_telegrams()} instead:\n",
        table(_SIGNAL_HEADER, map(_signal_row, POSITIONER_FORMS.values())),
    ]
    for signal in CATALOGUE:
        if signal.bits:
            out += [f"### {signal.name}\n", _bits(signal)]
    for signal in POSITIONER_FORMS.values():
        if signal.bits:
            out += [f"### {signal.name} of telegrams {_positioner_telegrams(signal)}\n", _bits(signal)]
    out += [
        "## Positioner\n",
        _POSITIONER,
        _positioner(POSITIONER_TRANSITIONS),
        "### Telegram 9\n",
        _MDI,
        _positioner(MDI_TRANSITIONS),
        "## Drive states\n",
        table(("state", "Statusword"), ((p.state.value, f"`{_pattern(p.mask, p.value)}`") for p in STATUS_PATTERNS)),
        "## Commands of the Controlword\n",
        table(
            ("transition", "from", "command", "to"),
            ((t.number, t.source.value, t.command.name, t.target.value) for t in COMMAND_TRANSITIONS),
        ),
        "## Sensor interface: G1_STW and G1_ZSW\n",
        table(("state", "event", "next state"), ((s.value, e.value, n.value) for (s, e), n in TRANSITIONS.items())),
        table(("state", "G1_ZSW"), ((state.value, f"{bits:04X}h") for state, bits in SENSOR_STATUS.items())),
        "### Error codes in G1_XIST2\n",
        table(("code", "error"), ((f"{code:04X}h", text) for code, text in SENSOR_ERROR_TEXTS.items())),
        "## Modes of operation\n",
        table(("6060h", "mode"), (*FAMILY_MODES.items(), *((mode.value, mode.name) for mode in Mode))),
        "## What acts in a mode\n",
        "Where an RPDO of the telegram contains an object, the gateway commands it. In telegram 100 nothing is set.\n",
        table(
            ("object", "modes (6060h)", "acts as", "treatment", "why"),
            (
                (
                    f"{row.entry}{'' if row.mask == -1 else f', bits {row.mask:02X}h'}",
                    ", ".join(str(mode.value) for mode in sorted(row.modes)),
                    row.effect.value,
                    row.treatment.value,
                    row.why,
                )
                for row in ACTING
            ),
        ),
        "## Homing methods\n",
        table(("6098h", "method"), HOMING_METHODS.items()),
        "## PDO layouts\n",
        table(
            ("operation", "PDO", "objects", "bytes"),
            (
                (operation.value, pdo, ", ".join(str(entry) for entry in pdo.entries), pdo.size)
                for operation, needs in LAYOUTS.items()
                for layout in (with_objects(needs, FAMILY.entries),)
                for pdo in (*layout.rpdos, *layout.tpdos)
            ),
        ),
        "## Objects a telegram can do without\n",
        table(
            ("operation", "object", "without it"),
            (
                (operation.value, DRIVE_OBJECTS.attribute(attribute), text)
                for operation, needs in LAYOUTS.items()
                for attribute, text in needs.optional.items()
            ),
        ),
        "## Drive objects\n",
        table(
            ("index", "sub", "name", "type", "access", "PDO", "unit"),
            (
                (f"{e.index:04X}h", e.subindex, e.name, e.type.name, e.access.value, "yes" if e.pdo else "", e.unit)
                for e in OBJECTS.entries
            ),
        ),
        "## Encoder types\n",
        table(
            ("1000h, high word", "type"), ((item.value, item.name.lower().replace("_", " ")) for item in EncoderType)
        ),
        "## Encoder objects\n",
        table(
            ("index", "name", "type", "access", "PDO", "C1", "C2", "for", "unit"),
            (
                (
                    f"{row.index:04X}h",
                    row.name,
                    f"{row.type.name}{' per channel' if row.per_channel else f' x {len(row.fields)}' if row.fields else ''}",
                    row.access.value,
                    "yes" if row.pdo else "",
                    row.c1.value,
                    row.c2.value,
                    _encoder_types(row),
                    row.unit,
                )
                for row in PROFILE
            ),
        ),
        "## Bits of the encoder's registers\n",
        table(
            ("object", "bit", "meaning"),
            (
                (title, bit.value.bit_length() - 1, (bit.name or "").lower().replace("_", " "))
                for title, bits in (
                    ("6000h operating parameters", Operating),
                    ("6400h area state", AreaState),
                    ("6503h alarms", Alarm),
                    ("6505h warnings", Warnings),
                )
                for bit in bits
            ),
        ),
        "## EMCY error codes of encoders\n",
        table(("code", "meaning"), ((f"{code:04X}h", text) for code, text in ENCODER_EMCY.items())),
        "## Fault numbers of the drive (200Ch, P947)\n",
        table(
            ("number", "fault", "EMCY code", "channel error"),
            ((f.number, f.name, f"{f.error_code:04X}h", f.channel_error.text) for f in DRIVE_FAULTS.values()),
        ),
        "## Fault numbers of the gateway (P947)\n",
        table(
            ("number", "fault", "P945", "kind", "by", "remedy"),
            (
                (f.value, f.title, f"{f.code:04X}h", f.weight.value, f.by.value, remedy_text(f.remedy))
                for f in FaultNumber
            ),
        ),
        "## Message classes of the diagnosis\n",
        "By the leading digits of the error code (EMCY, 603Fh); the longest match counts.\n",
        table(
            ("error code", "class", "text"),
            (
                (digits.ljust(4, "x"), f"{kind:04X}h", MESSAGE_CLASS_TEXTS[kind])
                for digits, kind in MESSAGE_CLASSES.items()
            ),
        ),
        "## Parameters of the profile\n",
        table(
            ("PNU", "name", "type", "access", "of", "unit", "meaning", "elements"),
            (
                (
                    spec.pnu,
                    spec.name,
                    spec.type.name + (" array" if spec.array else ""),
                    "rw" if spec.writable else "r",
                    spec.scope.value,
                    spec.unit,
                    spec.meaning,
                    ", ".join(spec.elements),
                )
                for spec in PARAMETERS.values()
            ),
        ),
        "## Data types of the parameter channel\n",
        table(
            ("code", "type", "bytes"),
            (
                (
                    _marked(f"{t.code:02X}h", Confidence.UNVERIFIED if t in UNVERIFIED else Confidence.CONFIRMED),
                    t.name,
                    t.size,
                )
                for t in sorted(DataType, key=lambda item: item.code)
            ),
        ),
        "## Error numbers of the parameter channel\n",
        table(("number", "meaning"), ((f"{number:02X}h", text) for number, text in ERROR_TEXTS.items())),
        "## SDO abort codes and error numbers\n",
        table(
            ("abort code", "meaning", "error number"),
            ((*abort_text(code).split(": ", 1), f"{error_of_abort(code):02X}h") for code in ABORT_TEXTS),
        ),
        "## Objects that a powered axis keeps\n",
        table(
            ("objects", "why", "after a write while it is off"),
            (
                (
                    f"{item.first:04X}h" if item.first == item.last else f"{item.first:04X}h-{item.last:04X}h",
                    item.reason,
                    item.check.value,
                )
                for item in GUARDED
            ),
        ),
        "## Simulated drives\n",
        table(("name", "drive"), ((f"`{name}`", shape.text) for name, shape in SHAPES.items())),
        "## Actions of the PLC simulator\n",
        generate_steps(),
        "## Packages\n",
        table(("package", "contents"), _packages()),
        "## Why it does not move\n",
        table(
            ("reason", "text", "state", "first broken link", "what to do"),
            ((item.name, item.value, item.state.value, item.enable.value, remedy_text(item.remedy)) for item in Reason),
        ),
        "## Power table\n",
        "In each cycle and for every telegram, the first matching row of `gateway/axis/power_table.py` decides what the gateway "
        "does with the power stage of a drive.\n",
        *_power_table(),
        *supervisions.generate(),
    ]
    return "\n".join(out)


def _names(members: Sequence[enum.IntEnum], everything: Sequence[enum.IntEnum]) -> str:
    return "any" if len(members) == len(everything) else ", ".join(_name(member) for member in members)


def _name(member: enum.IntEnum) -> str:
    return member.name.lower().replace("_", " ")


def _power_table() -> Sequence[str]:
    """The power table and its limits of time."""
    rows = (
        (
            number,
            _names(row.phases, ANY_PHASE),
            _names(row.drives, ANY_DRIVE),
            _names(row.wishes, ANY_WISH),
            "stays" if row.phase is None else _name(row.phase),
            _name(row.action),
            row.reason.name if row.reason else "",
            row.why,
            "" if row.fault is None else int(row.fault),
        )
        for number, row in enumerate(ROWS, 1)
    )
    limits = (
        (_names(d, ANY_DRIVE), _names(a, tuple(Action)), _names(w, ANY_WISH), _name(order))
        for d, a, w, order in ORDER_ROWS
    )
    columns = (
        (
            _name(order),
            item.text,
            LEAVE_TEXTS[item.leave],
            LINE_TEXTS[item.line],
            "" if not order else f"{int(item.fault)}, {'NMT stop' if item.stops else 'Quick Stop'}",
        )
        for order, item in ORDERS.items()
    )
    words = ("of the telegram" if a is Action.PASS else f"{CONTROLWORDS[a]:04X}h" for a in Action)
    return (
        table(("row", "phase", "drive shows", "requested", "next phase", "command", "reason", "why", "fault"), rows),
        f"Phases: {', '.join(map(_name, Phase))}. Drive states: {', '.join(map(_name, Drive))}.",
        f"Requests: {', '.join(map(_name, PowerWish))}.\n",
        table(("command", "Controlword bits 0-3"), zip(map(_name, Action), words, strict=True)),
        "## Orders\n",
        "Each order is watched until the shaft has followed it. The first matching row names the order of a command.\n",
        table(("drive shows", "command", "requested", "order"), limits),
        "In operation, `setpoint` is in force, and `halt` while Halt (CW.8) is commanded. A drive that does not leave its state "
        "in time, or whose speed is above its line, has the fault, and gets the next stop. Speeds inside the standstill "
        "window are below every line but that of `setpoint`.\n",
        table(("order", "what must come", "leaves its state within", "line of the speed", "fault, next stop"), columns),
        "Measured with the default settings: a simulated drive turns with 100 % speed and receives no RPDO from the moment of "
        "the order. `row` is the one that found it; the NMT stop then ends the motion, on the ramp of the drive's quick stop. "
        'With `dsc = "position"` the shaft is at standstill at once, because no position follows.\n',
        order_times.order_table(),
    )


if __name__ == "__main__":
    PATH.write_text(generate(), encoding="utf-8")
    package_picture.PATH.write_text(package_picture.generate(), encoding="utf-8")
    write_part(*habits.PLACE, habits.generate())
    counting.write_documents()
