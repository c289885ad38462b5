"""The integrity audit on a submission's page."""

from typing import Any

import httpx

from tests.integration.api.test_integrity import scored
from tests.integration.pages.test_pages import Score, ann
from tests.integration.site import Site
from tests.services.installation import with_boxes


def test_a_team_reads_that_its_boxes_face_backwards(site: Site, archive: bytes, score: Score) -> None:
    """Its own page says so and what to do; sound predictions are told nothing, and others see no audit."""
    sound = scored(site, site.token(), archive, score)
    turned = scored(site, site.token(), with_boxes(archive, _turn_round), score)
    with ann(site) as client:
        assert "face backwards. If" not in _page(client, sound)
        told = _page(client, turned)
        assert "<dt>matched boxes that face backwards (%)</dt><dd>100.0</dd>" in told
        assert "turn every yaw by half a circle" in told
    with httpx.Client(base_url=site.url, timeout=30) as visitor:
        assert "backwards" not in visitor.get(turned.removeprefix("/api/v1")).text


def _page(client: httpx.Client, place: str) -> str:
    return client.get(place.removeprefix("/api/v1")).raise_for_status().text


def _turn_round(box: dict[str, Any]) -> None:
    """Turn a box about its own vertical axis: (w, x, y, z) times (0, 0, 0, 1) is (-z, y, -x, w)."""
    w, x, y, z = box["rotation"]
    box["rotation"] = [-z, y, -x, w]
