"""What the interactive page of a campaign or a lot says beside the words of compare, diagnose and refine."""

from __future__ import annotations

WAITING = "waiting for the work before"
DEFECT = "internal error"
