"""The codec of PDOs: values of an image in the order of the mapping, little-endian."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest

from pdgw.ds301.aborts import CanopenError
from pdgw.ds301.objects import Access, CanType, Entry
from pdgw.ds301.pdo import Pdo, PdoDirection

STATUS = Entry(0x6041, 0, "Statusword", CanType.U16, Access.RO, True, attribute="statusword")
SPEED = Entry(0x606C, 0, "Velocity actual value", CanType.I32, Access.RO, True, attribute="velocity")
MODE = Entry(0x6061, 0, "Mode display", CanType.I8, Access.RO, True, attribute="mode")


def test_values_travel_in_the_order_of_the_mapping() -> None:
    pdo = Pdo(PdoDirection.TPDO, 1, (STATUS, SPEED, MODE))
    data = pdo.pack(SimpleNamespace(statusword=0x0637, velocity=-2, mode=-1))
    assert data.hex() == "3706feffffffff"
    image = SimpleNamespace()
    pdo.unpack_into(data + b"\0", image)
    assert vars(image) == {"statusword": 0x0637, "velocity": -2, "mode": -1}


def test_a_pdo_may_carry_one_value() -> None:
    pdo = Pdo(PdoDirection.TPDO, 2, (SPEED,))
    image = SimpleNamespace(velocity=0)
    pdo.unpack_into(pdo.pack(SimpleNamespace(velocity=5)), image)
    assert image.velocity == 5


def test_a_short_frame_changes_nothing() -> None:
    image = SimpleNamespace(statusword=1, velocity=2)
    with pytest.raises(CanopenError, match="TPDO1 length: 5 is not allowed, expected 6 bytes"):
        Pdo(PdoDirection.TPDO, 1, (STATUS, SPEED)).unpack_into(bytes(5), image)
    assert vars(image) == {"statusword": 1, "velocity": 2}


@pytest.mark.parametrize("name", ["", "x,y", "a b", "__import__('os')"])
def test_object_without_a_name_in_the_images_cannot_be_mapped(name: str) -> None:
    with pytest.raises(CanopenError, match="a name in the images"):
        Pdo(PdoDirection.TPDO, 1, (replace(SPEED, attribute=name),))


def test_more_than_eight_bytes_do_not_fit() -> None:
    with pytest.raises(CanopenError, match=r"1\.\.8 bytes"):
        Pdo(PdoDirection.TPDO, 1, (SPEED, SPEED, MODE))
