"""No order without a row: each setpoint and bit of every telegram is watched, or has a reason why it need not be."""

from __future__ import annotations

from collections import defaultdict

import pytest

from pdgw.gateway.axis.orders import ORDERS, Order
from pdgw.gateway.axis.telegrams import DRIVE_TELEGRAM_NUMBERS
from pdgw.profidrive.telegrams import TELEGRAMS
from tests.conformance.rig import COMPLETE
from tests.support.documents.order_list import ENTRIES, entries, names_of, ordered_by
from tests.support.documents.order_times import Case, cases, kept, measure


@pytest.mark.parametrize("number", TELEGRAMS)
def test_each_setpoint_and_bit_has_its_orders_or_a_reason(number: int) -> None:
    counts = {name: len(entries(number, name)) for name in ordered_by(number)}
    assert {name: count for name, count in counts.items() if count != 1} == {}


def test_each_entry_is_of_a_telegram_and_either_watched_or_explained() -> None:
    ordered = {(number, name) for number in TELEGRAMS for name in ordered_by(number)}
    for entry in ENTRIES:
        assert bool(entry.orders) != bool(entry.why), entry
        for name in names_of(entry):
            assert any((number, name) in ordered for number in entry.telegrams), name


@pytest.mark.parametrize("number", DRIVE_TELEGRAM_NUMBERS)
def test_each_order_is_measured_in_each_telegram(number: int) -> None:
    watched = {name: set(entries(number, name)[0].orders) for name in ordered_by(number)}
    measured = defaultdict(set)
    for case in cases(number):
        for name in case.names:
            measured[name] |= set(case.orders)
    assert measured == {name: orders for name, orders in watched.items() if orders}


def test_each_row_is_measured_but_those_after_another_order() -> None:
    measured = {order for number in DRIVE_TELEGRAM_NUMBERS for case in cases(number) for order in case.orders}
    assert measured == ORDERS.keys() - {Order.NONE, Order.OFF, Order.STANDSTILL}


EVERY = [case for number in DRIVE_TELEGRAM_NUMBERS for case in cases(number)]
FIRST = {(case.motion.name, case.text): case for case in reversed(EVERY)}
"""Each order in each motion once, with the telegram of the lowest number."""


@pytest.mark.parametrize("case", EVERY if COMPLETE else FIRST.values(), ids=lambda case: case.title)
def test_drive_that_receives_nothing_ends_within_its_row(case: Case) -> None:
    found = measure(case)
    assert found.row in {order.name.lower() for order in case.orders}
    assert found in kept(), "run: make docs"


def test_the_table_has_each_case_and_no_other() -> None:
    assert [(line.telegram, line.motion, line.text) for line in kept()] == [
        (case.telegram, case.motion.name, case.text) for case in EVERY
    ]
