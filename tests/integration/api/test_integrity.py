"""Scores that need a maintainer's look: held, explained to their team, released."""

import io
import json
import zipfile
from collections.abc import Callable

import sqlalchemy as sa

from server import benchmarks
from server.models import AuditEvent, Submission
from tests.integration.site import Site, send
from tests.services.installation import ORACLE, zip_of

IGNORE_CASE = ORACLE / "ignore_regions"
"""One image, whose false positives have modal boxes in its ignore regions, where they do not count."""


def scored(site: Site, token: str, archive: bytes, score: Callable[[str], None]) -> str:
    """Send an archive and have it scored; give the submission's address."""
    with site.client(token) as client:
        document = send(client, archive).json()
    score(document["id"])
    place: str = document["links"]["self"]
    return place


def test_a_copy_of_another_teams_predictions_is_held(site: Site, archive: bytes, score: Callable[[str], None]) -> None:
    """The second team's equal predictions are scored but not published, and the first team stays unnamed."""
    scored(site, site.token(), archive, score)
    stranger = site.stranger()
    copy = scored(site, stranger, archive, score)
    with site.client(stranger) as client:
        document = client.get(copy).json()
        assert document["state"] == "scored"
        assert "nearly identical" in document["held"]
        refused = client.post(f"{copy}/publication", json={"publication": "published"})
        assert (refused.status_code, refused.json()["code"]) == (409, "held_for_review")
        assert "lab" not in refused.text
        assert client.post(f"{copy}/release").status_code == 403
    with site.services.snapshot() as session:
        held = session.scalars(sa.select(AuditEvent).where(AuditEvent.action == "submission.held")).one()
        first = session.scalars(sa.select(Submission).order_by(Submission.created_at)).first()
        assert first is not None
        assert held.detail["resembles"] == str(first.id)


def test_modal_boxes_hidden_in_ignore_regions_are_held(site: Site, score: Callable[[str], None]) -> None:
    """The team is told the reason and cannot publish; the same boxes without those modal boxes pass."""
    with site.services.transaction() as session:
        phase = benchmarks.find_phase(session, "cs3d", "test")
        benchmarks.import_ground_truth(
            session, site.services.blobs, phase=phase, source=IGNORE_CASE / "gt", actor="admin:test"
        )
    token = site.token()
    hidden = scored(site, token, zip_of(IGNORE_CASE / "pred"), score)
    honest = scored(site, token, _without_modal_boxes(), score)
    # The oracle's mDS is 0.9333. With projected modal boxes the false positives count, which leaves 0.7381.
    reason = "The submitted modal boxes raise the mDS by 0.1952 through ignore regions."
    with site.client(token) as client:
        document = client.get(hidden).json()
        assert (document["state"], document["held"]) == ("scored", reason)
        assert client.get(f"{hidden}/integrity").json()["reasons"] == [reason]
        refused = client.post(f"{hidden}/publication", json={"publication": "published"})
        assert (refused.status_code, refused.json()["code"]) == (409, "held_for_review")
        assert client.get(honest).json()["held"] is None
        published = client.post(f"{honest}/publication", json={"publication": "published"})
        assert published.json()["publication"] == "published"
    with site.services.snapshot() as session:
        held = session.scalars(sa.select(AuditEvent).where(AuditEvent.action == "submission.held")).one()
        assert held.detail["reason"] == reason


def _without_modal_boxes() -> bytes:
    """Pack the case's predictions without modal boxes: then the amodal ones are tested."""
    (path,) = (IGNORE_CASE / "pred").iterdir()
    document = json.loads(path.read_bytes())
    for box in document["objects"]:
        del box["2d"]["modal"]
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as packed:
        packed.writestr(path.name, json.dumps(document))
    return buffer.getvalue()


def test_a_maintainer_releases_what_is_held(site: Site, archive: bytes, score: Callable[[str], None]) -> None:
    """Once released, a held submission is published like any other; the decision is in the audit trail."""
    scored(site, site.token(), archive, score)
    stranger = site.stranger()
    copy = scored(site, stranger, archive, score)
    maintainer = site.stranger(email="max@example.org", team="maintainers", is_maintainer=True)
    with site.client(maintainer) as client:
        assert client.post(f"{copy}/release").json()["held"] is None
    with site.client(stranger) as client:
        published = client.post(f"{copy}/publication", json={"publication": "published"})
        assert published.json()["publication"] == "published"
    with site.services.snapshot() as session:
        released = sa.select(sa.func.count()).where(AuditEvent.action == "submission.released")
        assert session.scalar(released) == 1


def test_the_audit_is_for_the_team_alone(site: Site, archive: bytes, score: Callable[[str], None]) -> None:
    """A team reads its score's audit; for others a private submission does not exist, a published one says no."""
    token = site.token()
    own = scored(site, token, archive, score)
    stranger = site.stranger()
    with site.client(token) as client, site.client(stranger) as other:
        audit = client.get(f"{own}/integrity").json()
        # Honest modal boxes: with the projected ones instead the score is the same.
        assert audit["modal_gap"] == 0
        assert not audit["held"]
        assert other.get(f"{own}/integrity").status_code == 404
        client.post(f"{own}/publication", json={"publication": "published"})
        assert other.get(f"{own}/integrity").status_code == 403
        assert other.get(own).json()["held"] is None
