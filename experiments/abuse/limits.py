"""What a reader may take for one input, and how much of the time each reader gets."""

SECONDS = 10.0
"""An input that takes longer hangs."""
MEMORY = 1 << 30
"""Bytes that a reader may take beyond what the process had."""
SHARES = {
    "raw": 6,
    "jpeg": 4,
    "picture": 4,
    "recipe": 3,
    "settings": 1,
    "config": 1,
    "mosaic": 1,
    "opcodes": 1,
    "mixture": 1,
    "noise": 1,
    "profile": 1,
    "network": 1,
    "journal": 1,
    "sample": 1,
    "manifest": 1,
    "note": 1,
    "record": 1,
    "checkpoint": 1,
    "log": 1,
    "archive": 2,
    "sums": 1,
    "report": 1,
}
"""Of the time, for each kind of reader."""


def file_name(kind: str, suffix: str) -> str:
    """What an input is called."""
    return {"settings": "dataset.toml", "sums": "checksums.json"}.get(kind, f"input{suffix}")
