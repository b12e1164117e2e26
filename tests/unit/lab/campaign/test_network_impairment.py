"""An injected impairment impairs its link, but in no sham campaign."""

from __future__ import annotations

from pcmrs_lab.campaign.network_impairment import InjectedImpairment
from pcmrs_lab.campaign.sham import sham


def test_no_link_is_impaired_in_a_sham_campaign() -> None:
    weather = InjectedImpairment(loss=1.0, doubled=1.0, delay=9.0, jitter=9.0, rate=1.0, towards=False, back=False)
    with sham():
        assert weather.delays(0.0) == [0.0]
        assert weather.wait(1.0) == 0.0
        assert (weather.passes("towards"), weather.passes("back"), weather.narrow) == (True, True, None)
        assert (weather.counted["lost"], weather.counted["doubled"]) == (0, 0)
    assert weather.delays(2.0) == []
    assert weather.narrow == 1.0
