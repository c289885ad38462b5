"""Examples shown in the OpenAPI document."""

from typing import Any

SUBMISSION_ID = "3f0c8f6e-5d7a-4b8e-9f39-0d3a4f1c2b7a"

_OWN = f"/api/v1/submissions/{SUBMISSION_ID}"

LINKS = {
    "self": _OWN,
    "results": f"{_OWN}/results",
    "events": f"{_OWN}/events",
    "page": f"/submissions/{SUBMISSION_ID}",
}

SUBMISSION: dict[str, Any] = {
    "id": SUBMISSION_ID,
    "benchmark": "cityscapes3d",
    "phase": "test",
    "method": "mono-baseline",
    "method_name": "Mono baseline",
    "team": "example-team",
    "state": "scoring",
    "terminal": False,
    "created_at": "2026-11-22T04:10:00Z",
    "state_changed_at": "2026-11-22T04:10:02Z",
    "attempt": 1,
    "progress": {"stage": "scoring", "images_done": 120, "images_total": 200},
    "publication": "private",
    "held": None,
    "predictions": {"sha256": "ab" * 32, "size_bytes": 1048576, "file_name": "predictions.zip"},
    "failure": None,
    "report": None,
    "mds": None,
    "signature": None,
    "links": LINKS,
}

LEADERBOARD: dict[str, Any] = {
    "benchmark": "cityscapes3d",
    "phase": "test",
    "protocol": "cityscapes3d",
    "rows": [
        {
            "rank": 1,
            "method": "mono-baseline",
            "method_name": "Mono baseline",
            "paper_url": "https://example.org/paper",
            "code_url": None,
            "team": "example-team",
            "team_name": "Example team",
            "submission_id": SUBMISSION_ID,
            "mds": 0.425,
            "mds_interval": [0.412, 0.439],
            "rank_interval": [1, 2],
            "groups": ["a"],
            "map": 0.5,
            "mbevcd": 0.9,
            "myaw_sim": 0.8,
            "mpr_sim": 0.95,
            "msize_sim": 0.75,
            "created_at": "2026-11-22T04:10:00Z",
            "signature": "cityscapes3d:1|evaluator:1|gt:ab12ab12ab12|pred:cd34cd34cd34",
            "classes": {
                "car": {
                    "ap": 0.5,
                    "bevcd": 0.9,
                    "yaw_sim": 0.8,
                    "pr_sim": 0.95,
                    "size_sim": 0.75,
                    "detection_score": 0.425,
                }
            },
            "links": LINKS,
        }
    ],
}

BENCHMARKS: dict[str, Any] = {
    "benchmarks": [
        {
            "slug": "cityscapes3d",
            "title": "Cityscapes 3D",
            "description": "3D vehicle detection from monocular images.",
            "phases": [
                {
                    "slug": "test",
                    "title": "Test",
                    "protocol": "cityscapes3d",
                    "is_open": False,
                    "allows_publication": True,
                    "opens_at": None,
                    "closes_at": None,
                    "submissions_per_day": 10,
                    "images": 1525,
                }
            ],
        }
    ]
}

UPLOAD: dict[str, Any] = {
    "id": "6d0c1df0-6c3c-4b34-a0ec-2f0e3bb24c11",
    "offset": 1048576,
    "length": 4194304,
    "expires_at": "2026-11-23T04:10:00Z",
    "complete": False,
    "submission_id": None,
}
