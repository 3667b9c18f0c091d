"""The parameter channel as the page reads it."""

from __future__ import annotations

import pytest

from pdgw.gateway.errors import GatewayError
from pdgw.tools.web.parameters import PageParameters
from pdgw.tools.web.support import RequestError
from tests.support.gateways.daemon import axis, configuration, reached, serving


def test_elements_have_name_unit_and_meaning() -> None:
    with serving(configuration(axis(1))) as (daemon, client), reached(daemon):
        parameters = PageParameters(client.address)
        (telegram,) = parameters.read(1, "P922")
        assert (telegram["parameter"], telegram["name"], telegram["value"]) == ("P922", "Telegram", 1)
        (statusword,) = parameters.read(1, "6041h")
        assert statusword["meaning"].endswith("Switch On Disabled")
        vendor, product = parameters.read(1, "1018h.1-2")
        assert (vendor["parameter"], product["parameter"]) == ("1018h.1", "1018h.2")
        (missing,) = parameters.read(1, "P40")
        assert missing["error"] is not None
        assert missing["meaning"]
        names = {item["pnu"]: item["name"] for item in parameters.names(1)}
        assert names["P922"] == "Telegram"
        assert names["6041h"] == "Statusword"


def test_dump_can_be_restored() -> None:
    with serving(configuration(axis(1))) as (daemon, client), reached(daemon):
        document = PageParameters(client.address).dump(1)
    assert (document["version"], document["do_id"]) == (1, 1)
    assert any(item["pnu"] == 922 for item in document["parameters"])


def test_invalid_parameters_and_missing_channel_are_reported() -> None:
    with pytest.raises(RequestError, match="not understood, expected for example") as wrong:
        PageParameters(("127.0.0.1", 9)).read(1, "speed")
    assert (wrong.value.status, wrong.value.field) == (400, "pnu")
    with pytest.raises(GatewayError, match="only the controller can read parameters"):
        PageParameters(None).read(1, "P922")
