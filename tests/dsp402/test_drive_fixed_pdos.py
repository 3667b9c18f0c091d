"""Drives with fixed PDO mappings."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import pytest

from pdgw.base.durations import MS
from pdgw.ds301.aborts import Abort, SdoAbortedError
from pdgw.ds301.configuration import EVENT_DRIVEN_MANUFACTURER, EVENT_DRIVEN_PROFILE
from pdgw.ds301.pdo import COB_ID_INVALID, PdoDirection
from pdgw.dsp402.drive.client import DriveClient
from pdgw.dsp402.drive.settings import DriveSettings
from pdgw.dsp402.pdo.layouts import LAYOUTS, Operation
from pdgw.peers.drive import SimulatedDrive, SimulatedDriveNode
from tests.support.axis.mapping import engel_layout, pdo_steps
from tests.support.drives.plant import NODE, Plant, observe


class _Fixed(SimulatedDriveNode):
    """Its PDO parameters are the manufacturer's and read-only."""

    fixed: Collection[int] = range(0x1400, 0x1C00)

    def set_data(self, index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        if index in self.fixed:
            raise SdoAbortedError(Abort.READ_ONLY)
        super().set_data(index, subindex, data, check_writable)


def _fixed(plant: Plant, operation: Operation, values: dict[tuple[int, int], int]) -> SimulatedDrive:
    """A drive whose PDOs are made for an operation, but for ``values``; its other PDOs cannot be switched off."""
    layout = engel_layout(operation)
    available = [d.communication_index + n for d in PdoDirection for n in range(5)]
    steps = pdo_steps(layout, NODE, available, sync=False, event_ms=50, inhibit_us=0)
    fixed = {(step.index, step.subindex): step.value for step in steps}
    return plant.power_on(_Fixed, fixed | {(0x1801, 1): 0x284} | values)


@pytest.mark.parametrize("operation", list(Operation))
@pytest.mark.parametrize(
    "values",
    [{}, {(0x1800, 1): 0x4000_0184, (0x1400, 2): 254, (0x1800, 2): 254}],
    ids=["as wanted", "no remote request, type 254"],
)
def test_fixed_pdos_that_match_are_used(plant: Plant, operation: Operation, values: dict[tuple[int, int], int]) -> None:
    _fixed(plant, operation, values)
    plant.connected(operation, initial_mode=None)
    plant.hear()


@pytest.mark.parametrize(("mapped", "writes"), [(0x60FF_0020, 0), (0x6071_0010, 4)])
def test_a_mapping_the_drive_has_already_is_not_written_again(plant: Plant, mapped: int, writes: int) -> None:
    plant.power_on().node.values |= {(0x1600, 1): mapped, (0x1600, 2): 0x6040_0010}
    seen = observe(plant)
    plant.connected(Operation.VELOCITY)
    assert len([index for index, _, _ in seen if index == 0x1600]) == writes


class _Knows254(SimulatedDriveNode):
    """Confirms type 255 for a TPDO, and then never sends it."""

    def sent_on_change(self, transmission_type: int) -> bool:
        return transmission_type == EVENT_DRIVEN_MANUFACTURER

    def event_timer(self, index: int) -> int:
        return super().event_timer(index) if self.sent_on_change(int(self.values[index, 2])) else 0


def _with_types(plant: Plant, type_: int) -> SimulatedDriveNode:
    return plant.power_on(_Knows254, {(index, 2): type_ for index in (0x1800, 0x1801)}).node


def test_transmission_type_254_of_a_drive_is_kept(plant: Plant) -> None:
    node = _with_types(plant, EVENT_DRIVEN_MANUFACTURER)
    seen = observe(plant)
    plant.connected(Operation.VELOCITY)
    assert [node.values[index, 2] for index in (0x1800, 0x1801)] == [254, 254]
    assert [item for item in seen if item[:2] in {(0x1800, 2), (0x1801, 2)}] == []


def test_synchronous_transmission_type_of_a_drive_is_not_kept(plant: Plant) -> None:
    node = plant.power_on().node
    node.values[0x1800, 2] = 1
    plant.connected(Operation.VELOCITY)
    assert node.values[0x1800, 2] == EVENT_DRIVEN_PROFILE


@pytest.mark.parametrize("sync", [False, True])
def test_rejection_of_a_drive_without_tpdos_names_sync(plant: Plant, sync: bool) -> None:
    _with_types(plant, EVENT_DRIVEN_PROFILE)
    plant.connect(Operation.VELOCITY, sync=sync)
    text = plant.refused()
    assert "none of TPDO1, TPDO2" in text
    assert ("set sync = true" in text) is not sync


class _Keeps(SimulatedDriveNode):
    """It confirms writes of ``kept`` objects (default: the mapping of its first RPDO and TPDO), and keeps its own values."""

    kept: Collection[tuple[int, int]] = {(index, subindex) for index in (0x1600, 0x1A00) for subindex in range(9)}

    def set_data(self, index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        if (index, subindex) not in self.kept:
            super().set_data(index, subindex, data, check_writable)


def _keeping(
    plant: Plant,
    mappings: Mapping[int, Sequence[int]] | None = None,
    values: Mapping[tuple[int, int], int] | None = None,
) -> SimulatedDrive:
    """A drive that keeps ``mappings``, or single ``values``."""
    own = {
        (index, number): value
        for index, mapping in (mappings or {}).items()
        for number, value in enumerate((len(mapping), *mapping))
    }
    drive = plant.power_on(_Keeps, own | (values or {}))
    if values is not None:
        assert isinstance(drive.node, _Keeps)
        drive.node.kept = values.keys()
    return drive


def test_mapping_that_a_drive_keeps_although_it_confirms_another_is_used_as_it_is(plant: Plant) -> None:
    """Else the Controlword would be taken for a speed, and the speed for a position."""
    values = {0x1600: (0x6040_0010, 0x60FF_0020), 0x1A00: (0x606C_0020, 0x6041_0010)}
    drive = _keeping(plant, values)
    plant.connected(Operation.VELOCITY)
    plant.hear(target_velocity=1000)
    assert drive.model.target_velocity == 1000


def test_rpdo_that_keeps_a_mapping_with_other_objects_is_not_used(plant: Plant) -> None:
    drive = _keeping(plant, {0x1600: (0x6071_0010, 0x6040_0010)})
    plant.connected(Operation.VELOCITY)
    assert drive.node.read(0x1400, 1) & COB_ID_INVALID
    plant.hear(target_velocity=1000)
    assert (drive.model.target_velocity, drive.model.target_torque) == (1000, 0)


@pytest.mark.parametrize(
    ("address", "value", "line"),
    [
        ((0x1400, 1), 0x244, "RPDO1 244h: Target Velocity 60FFh, Controlword 6040h; its own COB-ID"),
        ((0x1400, 2), 1, "RPDO1 is processed on SYNC: its transmission type cannot be written"),
        (
            (0x1800, 1),
            0x1C4,
            "TPDO1 1C4h: Statusword 6041h, Velocity Actual Value 606Ch; on change and by event timer; ",
        ),
        ((0x1800, 2), 1, "TPDO1 184h: Statusword 6041h, Velocity Actual Value 606Ch; on SYNC"),
        ((0x1800, 2), 0, "TPDO1 on SYNC after a change only: "),
        ((0x1800, 2), 253, "TPDO3 384h: Statusword 6041h, Velocity Actual Value 606Ch; on change and by event timer"),
    ],
)
def test_cob_id_and_transmission_type_that_a_drive_keeps_although_it_confirms_others_are_used(
    plant: Plant, address: tuple[int, int], value: int, line: str
) -> None:
    mappings = {0x1600: (0x60FF_0020, 0x6040_0010), 0x1A00: (0x6041_0010, 0x606C_0020)}
    _keeping(plant, mappings, values={address: value})
    client = plant.connect(Operation.VELOCITY)

    def send_sync() -> None:
        if plant.network.sync.required:
            plant.network.send_sync()
        client.loop.call_later(4 * MS, send_sync)

    send_sync()
    plant.online()
    assert client.plan is not None
    assert any(item.startswith(line) for item in client.plan.lines), client.plan.lines
    plant.hear()


def test_rpdo_that_stays_invalid_although_the_drive_confirms_its_cob_id_is_not_used(plant: Plant) -> None:
    _keeping(plant, values={(0x1400, 1): COB_ID_INVALID | 0x204})
    plant.connected(Operation.VELOCITY)
    plant.hear()


def test_unused_pdo_that_keeps_the_cob_id_of_another_node_is_refused(plant: Plant) -> None:
    _keeping(plant, values={(0x1803, 1): 0x385})
    plant.connect(Operation.VELOCITY)
    assert "TPDO4 unused: confirmed, but reads otherwise (1803h/1 := 80000484h)" in plant.refused()


@pytest.mark.parametrize(
    ("address", "value", "text"),
    [
        ((0x1600, 1), 0x6071_0010, "no RPDO for Controlword 6040h: fixed are 1600h with 6071h, 6040h"),
        ((0x1A00, 1), 0x6064_0020, "no TPDO for Statusword 6041h: fixed are 1A00h with 6064h, 606Ch"),
        ((0x1400, 1), 0x8000_0204, "no RPDO for Controlword 6040h"),
        ((0x1802, 1), 0x385, "TPDO3 unused (1802h/1 := 80000384h)"),
    ],
)
def test_fixed_pdos_that_do_not_carry_what_is_needed_are_named(
    plant: Plant, address: tuple[int, int], value: int, text: str
) -> None:
    _fixed(plant, Operation.VELOCITY, {address: value})
    plant.connect()
    assert text in plant.refused()


@pytest.mark.parametrize(
    ("address", "value", "line"),
    [
        ((0x1A00, 0), 1, "read by SDO every 100 ms: Velocity Actual Value 606Ch"),
        ((0x1400, 1), 0x244, "RPDO1 244h: Target Velocity 60FFh, Controlword 6040h; its own COB-ID"),
        (
            (0x1800, 5),
            500,
            "TPDO1 on change only: neither event timer nor SYNC can be set; heartbeat and SDO monitor the device",
        ),
    ],
)
def test_fixed_pdos_that_carry_what_is_needed_are_adopted_as_they_are(
    plant: Plant, address: tuple[int, int], value: int, line: str
) -> None:
    _fixed(plant, Operation.VELOCITY, {address: value})
    client = plant.connected()
    assert client.plan is not None
    assert line in client.plan.lines
    plant.hear()


@pytest.mark.parametrize(("address", "cob_id"), [((0x1400, 1), 0x205), ((0x1800, 1), 0x185)])
def test_drive_that_keeps_a_cob_id_of_another_node_is_refused(
    plant: Plant, address: tuple[int, int], cob_id: int
) -> None:
    _fixed(plant, Operation.VELOCITY, {address: cob_id})
    DriveClient(plant.network, DriveSettings(node_id=5), LAYOUTS[Operation.VELOCITY], plant.events.append)
    plant.connect()
    text = plant.refused()
    assert f"COB-ID {cob_id:03X}h" in text
    assert "node 5" in text
