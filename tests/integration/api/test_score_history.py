"""Every score of a submission can be read, before and after the phase was scored again."""

from collections.abc import Callable
from pathlib import Path

from server import benchmarks, rescoring, rescoring_decisions
from tests.integration.record.three_methods import predictions, second_ground_truth
from tests.integration.site import Site, send
from worker.rescoring import evaluate_item
from worker.sandbox import Sandbox


def _score_again(site: Site, sandbox: Sandbox, folder: Path) -> None:
    """Score everything on the second ground truth; publish nothing."""
    blobs = site.services.blobs
    prepared = benchmarks.prepare_ground_truth(blobs, second_ground_truth(folder))
    with site.services.transaction() as session:
        phase = benchmarks.find_phase(session, "cs3d", "test")
        version = benchmarks.add_ground_truth(session, blobs, phase=phase, prepared=prepared, actor="admin:test")
        one = rescoring.start(session, phase=phase, version=version.version, actor="admin:test")
        items = rescoring.waiting(session, one)
    for item_id in items:
        evaluate_item(site.services, sandbox, item_id, worker="test")


def test_results_list_every_score_and_give_any(
    site: Site, sandbox: Sandbox, score: Callable[[str], None], tmp_path: Path
) -> None:
    """The score that ranks comes by itself, another one by its id; an unpublished re-scoring shows nobody anything."""
    with site.client(site.token()) as client:
        submission_id = send(client, predictions("partial")).json()["id"]
        score(submission_id)
        results = f"/api/v1/submissions/{submission_id}/results"
        first = client.get(results)
        (old,) = first.json()["history"]
        assert (old["ranks"], old["mds"]) == (True, first.json()["mds"])
        _score_again(site, sandbox, tmp_path)
        assert client.get(results, headers={"If-None-Match": first.headers["etag"]}).status_code == 304
        assert client.get(results, params={"score": old["id"] + 1}).status_code == 404
        with site.services.transaction() as session:
            rescoring_decisions.publish(session, benchmarks.find_phase(session, "cs3d", "test"), "admin:test")
        after = client.get(results, headers={"If-None-Match": first.headers["etag"]})
        assert after.status_code == 200
        # On the second ground truth these predictions are perfect.
        assert after.json()["mds"] == 1.0
        assert [(one["ranks"], one["mds"]) for one in after.json()["history"]] == [(False, old["mds"]), (True, 1.0)]
        assert client.get(results, params={"score": old["id"]}).json()["mds"] == old["mds"]


def test_the_page_lists_both_scores(site: Site, sandbox: Sandbox, score: Callable[[str], None], tmp_path: Path) -> None:
    """Once the new scores are in force, the submission's page shows both with their signatures."""
    with site.client(site.token()) as client:
        submission_id = send(client, predictions("partial")).json()["id"]
        score(submission_id)
        change = {"publication": "published"}
        assert client.post(f"/api/v1/submissions/{submission_id}/publication", json=change).status_code == 200
        with site.client() as visitor:
            assert "Every score of this submission" not in visitor.get(f"/submissions/{submission_id}").text
            _score_again(site, sandbox, tmp_path)
            with site.services.transaction() as session:
                rescoring_decisions.publish(session, benchmarks.find_phase(session, "cs3d", "test"), "admin:test")
            page = visitor.get(f"/submissions/{submission_id}").text
        assert "Every score of this submission" in page
        assert page.count("/results?score=") == 2
