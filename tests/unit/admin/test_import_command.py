"""Importing ground truth takes minutes; nobody else's write waits for it."""

from pathlib import Path

import pytest

from evaluator.ground_truth import GroundTruth, read_ground_truth
from evaluator.synthetic import synthesize_ground_truth, write_zip
from server import accounts, benchmarks, database
from server.services import Services
from tests.unit.admin.test_commands import Admin, admin, data_dir, services

__all__ = ["admin", "data_dir", "services"]


def test_files_are_read_before_the_record_is_locked(
    admin: Admin, services: Services, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While the files are read somebody else writes; were the write lock held, that would end in `Unavailable`."""
    admin("create-benchmark", "cs3d", "--title", "Cityscapes 3D")
    admin("create-phase", "cs3d", "test", "--title", "Test")
    write_zip(synthesize_ground_truth(3, seed=1), tmp_path / "gt.zip")

    def read(source: Path) -> GroundTruth:
        with services.transaction() as session:
            accounts.create_team(session, slug="others", name="Others", members=[], actor="admin:test")
        return read_ground_truth(source)

    monkeypatch.setattr(database, "BUSY_TIMEOUT_S", 1)
    monkeypatch.setattr(benchmarks, "read_ground_truth", read)
    assert admin("import-ground-truth", "cs3d", "test", str(tmp_path / "gt.zip"))["in_force"]
    with services.snapshot() as session:
        assert accounts.find_team(session, "others").name == "Others"
    services.close()
