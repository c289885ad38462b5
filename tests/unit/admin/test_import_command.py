"""What ground truth is imported from; importing takes minutes, and nobody else's write waits for it."""

import json
from pathlib import Path

import pytest

from evaluator.ground_truth import GroundTruth, read_ground_truth
from evaluator.synthetic import synthesize_ground_truth, write_zip
from server import accounts, benchmarks, database
from server.admin.main import main
from server.services import Services
from tests.unit.admin.filled import Admin


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


@pytest.mark.parametrize("packed", [True, False], ids=["zip", "folder"])
def test_ground_truth_comes_as_a_folder_or_a_zip(admin: Admin, tmp_path: Path, *, packed: bool) -> None:
    """Both forms give the same version, which is in force at once."""
    admin("create-benchmark", "cs3d", "--title", "Cityscapes 3D")
    admin("create-phase", "cs3d", "test", "--title", "Test")
    files = synthesize_ground_truth(4, seed=5)
    source = tmp_path / ("gt.zip" if packed else "gt")
    if packed:
        write_zip(files, source)
    else:
        source.mkdir()
        for name, content in files.items():
            (source / name).write_bytes(content)
    imported = admin("import-ground-truth", "cs3d", "test", str(source))
    boxes = sum(len(json.loads(content)["objects"]) for content in files.values())
    assert (imported["version"], imported["images"], imported["boxes"]) == (1, 4, boxes)
    assert imported["in_force"]


def test_ground_truth_with_errors_is_refused(
    data_dir: Path, admin: Admin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing is imported, and the message names the file that is wrong."""
    admin("create-benchmark", "cs3d", "--title", "Cityscapes 3D")
    admin("create-phase", "cs3d", "test", "--title", "Test")
    folder = tmp_path / "gt"
    folder.mkdir()
    (folder / "bonn_000000_000019_gtBbox3d.json").write_text("{")
    command = ["import-ground-truth", "cs3d", "test", str(folder), "--data-dir", str(data_dir)]
    assert main(command) == 1
    assert "bonn_000000_000019_gtBbox3d.json" in capsys.readouterr().err
