"""What the profile parameters say of the device: lists of parameters, application classes, texts of words, warnings."""

from __future__ import annotations

import pytest

from pdgw.gateway.base.fault_numbers import GATEWAY_FAULTS
from pdgw.gateway.client.session import Session
from pdgw.gateway.client.udp import ParameterClient
from pdgw.gateway.daemon.daemon import Daemon
from pdgw.gateway.parameters.bound_object import BoundObject
from pdgw.gateway.parameters.objects import RequestContext
from pdgw.profidrive.datatypes import DataType
from pdgw.profidrive.parameters.catalogue import LIST_PNUS, PARAMETERS
from tests.support.gateways.daemon import axis, configuration, serving, until
from tests.support.gateways.parameters import gateway, lists, number

ENCODER = "[[encoder]]\ndo_id = 5\nnode_id = 5\ntelegram = 83\nsimulate = true\n"


@pytest.mark.parametrize(
    ("objects", "do_id"), [(axis(1), 1), (ENCODER, 5), (axis(1) + ENCODER, 0)], ids=["axis", "encoder", "device"]
)
def test_lists_of_parameters_name_no_list(objects: str, do_id: int) -> None:
    with serving(configuration(objects), do_id) as (_, client):
        listed = [pnu for entries in lists(client) for pnu in entries]
    assert {965, 975, 978} <= set(listed)
    assert not {*LIST_PNUS} & set(listed)


def test_lists_of_parameters_have_room_for_any_number() -> None:
    listed = BoundObject(1)
    listed.further_pnus = lambda: range(0x2000, 0x2000 + 1500)  # type: ignore[method-assign]
    entries: list[int] = []
    for pnu in LIST_PNUS:
        part = listed.parameter(pnu, RequestContext())
        count = part.description().count
        *some, follower = (int(item) for item in part.read(0, count).values)
        entries += some
    assert (entries, follower) == ([*listed.further_pnus()], 0)


@pytest.mark.parametrize(("telegram_number", "classes"), [(1, 0b1), (3, 0b1001), (9, 0b100), (105, 0b1000), (100, 0)])
def test_subclass_of_an_axis_are_the_application_classes_of_its_telegram(telegram_number: int, classes: int) -> None:
    more = 'simulate = true\ndsc = "speed"\nfollowing_window = 10000' if telegram_number == 105 else "simulate = true"
    with gateway(axis(1, telegram_number=telegram_number, more=more)) as (_, client):
        assert number(client, 975, 6, 1) == classes


@pytest.mark.parametrize(("objects", "do_id"), [(axis(1), 1), (ENCODER, 5)], ids=["axis", "encoder"])
def test_bit_sequences_have_two_texts_for_each_bit(objects: str, do_id: int) -> None:
    with serving(configuration(objects), do_id) as (_, client):
        listed = [pnu for entries in lists(client) for pnu in entries if pnu in PARAMETERS]
        words = [pnu for pnu in listed if PARAMETERS[pnu].type is DataType.V2]
        assert words == ([953, 967, 968] if do_id == 1 else [953])
        texts = {pnu: Session(client).texts(pnu) for pnu in words}
    assert {len(each) for each in texts.values()} == {2 * 16}
    assert texts[953][:2] == ["no", GATEWAY_FAULTS[108].title[:16]]
    assert texts[953][-2:] == ["no", "device warning"]
    assert set(texts[953][2 * 8 + 1 : 2 * 10 : 2]) == {"reserved"}


@pytest.mark.planted
@pytest.mark.parametrize("number_", [number for number, fault in GATEWAY_FAULTS.items() if fault.is_warning])
def test_every_warning_is_a_bit_of_the_warning_word(
    shared: tuple[Daemon, ParameterClient], monkeypatch: pytest.MonkeyPatch, number_: int
) -> None:
    daemon, client = shared
    mask = GATEWAY_FAULTS[number_].warning_mask
    monkeypatch.setattr(daemon.axes[0].machine, "_warnings", lambda: mask)
    until(daemon, lambda: daemon.axes[0].outputs.warning == mask, "a cycle")
    bit = number(client, 953).bit_length() - 1
    name = GATEWAY_FAULTS[number_].title[:16] if number_ < 122 else "number above 123"
    assert Session(client).texts(953)[2 * bit + 1] == name
