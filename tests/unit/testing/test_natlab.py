"""Two sites behind NATs: which rules their NATs have, and what of their packets is dropped."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pcmrs.testing import natlab
from pcmrs.testing.natlab import NAT, NatLab, nat_lab
from pcmrs.testing.needs import Need
from tests.support.scripted_programs import Programs


@pytest.fixture
def programs(monkeypatch: pytest.MonkeyPatch) -> Programs:
    return Programs(monkeypatch)


def rules(programs: Programs, lab: NatLab) -> list[tuple[str, str]]:
    """Sides and rules that their NATs were given."""
    said = zip(programs.words, programs.inputs, strict=True)
    start = f"ip netns exec {lab.name}-nat-"
    return [(line.removeprefix(start).split()[0], text) for line, text in said if line.startswith(start) and text]


def test_both_sides_have_the_same_address_behind_their_own_nat(programs: Programs) -> None:
    with nat_lab() as lab:
        assert rules(programs, lab) == [("cell", NAT), ("remote", NAT)]
        for side in natlab.SIDES:
            assert f"ip -n {lab.name}-{side} address add {natlab.INSIDE}/24 dev lan" in programs.words
            assert f"ip -n {lab.name}-nat-{side} address add {natlab.OUTSIDE[side]}/24 dev wan" in programs.words
        forwarding = [line for line in programs.words if "ip_forward" in line]
        assert len(forwarding) == 3, "both NATs and the router forward, so that only a NAT can block"
    assert len(programs.deleted) == 5


@pytest.mark.parametrize(
    ("impair", "rule"),
    [
        (lambda lab: lab.lose("remote", 0.05), "numgen random mod 1000 < 50 drop"),
        (lambda lab: lab.lose("remote", 1.0), "numgen random mod 1000 < 1000 drop"),
        (lambda lab: lab.cut("remote"), "forward drop"),
    ],
)
def test_an_impairment_replaces_the_last_one_of_its_side(
    programs: Programs, impair: Callable[[NatLab], None], rule: str
) -> None:
    with nat_lab() as lab:
        impair(lab)
        side, text = rules(programs, lab)[-1]
        flush, added = text.strip().splitlines()
        assert (side, flush) == ("remote", "flush chain inet weather forward")
        assert added.endswith(rule)
        lab.restore("remote")
        assert rules(programs, lab)[-1][1].strip() == flush


def test_a_test_is_skipped_for_what_is_missing_first(monkeypatch: pytest.MonkeyPatch) -> None:
    needs = (Need("root", lambda: True), Need("nft", lambda: False), Need("namespaces", lambda: False))
    monkeypatch.setattr(natlab, "NEEDS", needs)
    assert natlab.missing() == "no nft"
    monkeypatch.setattr(natlab, "NEEDS", needs[:1])
    assert natlab.missing() == ""


def test_a_machine_without_loss_in_namespaces_is_missing_them(programs: Programs) -> None:
    need = natlab.NEEDS[-1]
    assert need.is_met()
    assert "numgen" in programs.inputs[-2]
    programs.fails = lambda line: line.endswith("nft -f -")
    assert not need.is_met()
    assert len(programs.deleted) == 2, "nothing of a trial stays"
