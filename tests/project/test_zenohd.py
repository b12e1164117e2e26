"""The configuration for zenohd says what pcmrs-router says, and lets nobody in by itself."""

import json

import zenoh

from pcmrs.bus.settings import BusSettings, Credentials
from tests import ROOT

FILE = ROOT / "deploy" / "router" / "zenohd.json5"


def test_zenohd_is_configured_as_our_router_configures_zenoh() -> None:
    ours = BusSettings(
        mode="router",
        endpoint="",
        listen=("tls/0.0.0.0:7449",),
        credentials=Credentials(
            name="router", cells=(), ends=0.0, certificate="router.pem", key="router.key", authority="ca.pem"
        ),
    )
    wanted, shipped = zenoh.Config(), zenoh.Config.from_file(str(FILE))

    for key, value in ours.zenoh_config().items():
        wanted.insert_json5(key, json.dumps(value))
        assert json.loads(shipped.get_json(key)) == json.loads(wanted.get_json(key)), key


def test_everything_is_denied_until_rules_are_printed_into_it() -> None:
    access = json.loads(zenoh.Config.from_file(str(FILE)).get_json("access_control"))

    assert (access["enabled"], access["default_permission"], access["rules"]) == (True, "deny", [])


def test_it_is_marked_as_not_run() -> None:
    assert FILE.read_text().startswith("// NOT RUN HERE")
