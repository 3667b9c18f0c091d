"""Where the gateway deviates from what its source documents print: the table of docs/translation.md is made from these rows."""

from __future__ import annotations

from typing import Final, NamedTuple

from tests.support.documents.parts import write_part

PLACE = ("translation.md", "deviations")
GUIDE: Final = "manufacturer's guide"
PROFILE: Final = "CiA DSP 406 V2.0"


class Deviation(NamedTuple):
    """What a document prints, what the gateway does instead and why. ``check``: the test that shows it, as pytest names it."""

    document: str
    chapter: str
    printed: str
    done: str
    why: str
    check: str


DEVIATIONS: Final = (
    Deviation(
        GUIDE,
        "6",
        "ZSW1.13 at standstill in an intermediate stop: 1 in the bit table, 0 in the diagram",
        "1",
        "the table defines the bit",
        "tests/gateway/axis/test_status_words.py::test_an_intermediate_stop_is_reached_when_an_axis_in_the_standstill_window_turns_no_more",
    ),
    Deviation(
        GUIDE,
        "6",
        "operation while positioning: ZSW1.0, .1 and .2 are 1, .4 and .6 are 0",
        "ZSW1.3 and .6 are 0; ZSW1.4 is 1 while no OFF2 acts, as in the bit table",
        "bit 3 is the fault, which ends operation; the digit is a misprint",
        "tests/gateway/axis/test_positioner.py::test_worked_example_111_absolute_to_50000_lu_at_12000",
    ),
    Deviation(
        GUIDE,
        "5.1",
        "operation needs digital input DI1 (enable)",
        "transition 4 only with DI1 set; DI1 falling acts as Disable Operation. The simulator has it",
        "the reaction is not printed",
        "tests/peers/test_drive.py::test_operation_needs_the_enable_input_and_ends_with_it",
    ),
    Deviation(
        GUIDE,
        "7.1",
        "Statusword of Quick Stop Active: x00x x011 in the diagram, x00x 0111 in the table",
        "the simulator sends 0111, the gateway accepts both",
        "bit 5 distinguishes it from Operation Enabled",
        "tests/test_published_layouts.py::test_the_states_have_the_patterns_that_are_read",
    ),
    Deviation(
        GUIDE,
        "7.8, 7.9",
        "ramp types of 6086h (0 linear, 1 sine-squared) without the unit of sine-squared",
        "linear: x 10 rpm/s; sine-squared: x ms of ramp time. The simulator has both",
        "the unit is not printed",
        "tests/peers/test_drive.py::test_sine_squared_ramp_takes_its_time_in_milliseconds_and_is_half_way_at_half_time",
    ),
    Deviation(
        GUIDE,
        "",
        "606Bh and 606Ch: the exponent is not legible",
        "0.5 rpm per unit (2^-1)",
        "the default of 6094h",
        "tests/dsp402/test_drive_type.py::test_answers_of_the_device_form_its_object_dictionary",
    ),
    Deviation(
        GUIDE,
        "",
        "error 6 is an over-voltage, like error 4",
        "under-voltage, EMCY 3220h",
        "3220h is an under-voltage in CiA 402",
        "tests/peers/test_habits.py::test_drive_fault_stays_until_it_is_removed",
    ),
    Deviation(
        GUIDE,
        "",
        "an example of a parameter request with swapped bytes in each word but the subindex",
        "the order of the profile; `pdgw decode` recognises the printed form",
        "PROFIdrive is big-endian",
        "tests/profidrive/parameters/test_codec.py::test_the_guides_word_swapped_print_is_recognised",
    ),
    Deviation(
        PROFILE,
        "8",
        "650Ah counts its fields from sub-index 0",
        "sub-indices 1 to 3. The fields of an encoder that has them from 0, with its own EDS, have their names in `pdgw param`",
        "CiA 301 keeps sub-index 0 for their number",
        "tests/tools/test_param.py::test_fields_of_650ah_have_their_names_in_the_layout_of_the_profile_too",
    ),
    Deviation(
        PROFILE,
        "8",
        "6020h: ro in the overview, rw in its detailed table",
        "ro",
        "a position is measured; 6003h presets it",
        "tests/dsp406/test_profile.py::test_each_row_of_the_overview",
    ),
)


def deviation_table() -> str:
    """The table of all deviations."""
    head = "| document and chapter | printed | gateway | why |\n| --- | --- | --- | --- |\n"
    return head + "".join(
        f"| {item.document} {item.chapter}".rstrip() + f" | {item.printed} | {item.done} | {item.why} |\n"
        for item in DEVIATIONS
    )


def write() -> None:
    """Write the table into the document (``make docs``)."""
    write_part(*PLACE, deviation_table())
