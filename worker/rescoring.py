"""What a bulk message leads to: claim an item of a re-scoring, score its submission, record the score beside the old one.

It is worker/attempt.py with another record: the same sandbox, heartbeats, patience and fence.
"""

from typing import ClassVar

import msgspec
import structlog

from evaluator.report import Report
from server import rescoring_items
from server.errors import StorageFull, Unavailable
from server.services import Services
from worker.attempt import Attempt, Record
from worker.evaluation import carry_out
from worker.sandbox import Sandbox

log = structlog.get_logger(__name__)


def evaluate_item(services: Services, sandbox: Sandbox, item_id: int, *, worker: str) -> None:
    """Score what an item stands for. Anything else than a waiting item: nothing."""
    try:
        with services.transaction() as session:
            held = rescoring_items.claim(session, item_id, worker=worker, lease_s=services.settings.lease_s)
    except (Unavailable, StorageFull) as error:
        log.warning("not_claimed", item_id=item_id, error=str(error))
        return
    if held is None:
        log.info("nothing_to_do", item_id=item_id)
        return
    carry_out(ItemAttempt(services, held), sandbox)


class ItemAttempt(Attempt):
    """One claim of an item being worked on; maintainers look at `cs3d-admin rescore status`, so no mail is sent."""

    record: ClassVar[Record] = rescoring_items

    def _validated(self) -> None:
        """Keep nothing: the submission has the report its team knows."""

    def _rejected(self) -> None:
        report = msgspec.json.decode((self.folder / "report.json").read_bytes(), type=Report)
        problems = (f"{group.code} ({group.count})" for group in report.groups if group.severity == "error")
        self.fail("rejected", f"the predictions have errors by the list of images to come: {', '.join(problems)}")

    def _tell_of_hold(self) -> None:
        """Tell nobody: what the integrity audit finds stands in the diff."""

    def _tell_of_failure(self) -> None:
        log.warning("item_failed", item_id=self.held.item_id)

    def _send_again(self) -> None:
        if self.held.item_id is not None:
            self.services.queue.enqueue_item(self.held.item_id)
