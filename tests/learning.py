"""What a run learns, for the tests of methods."""

from typing import Any

from sculpt_framework.engine.session import Session


def beginning_of(session: Session) -> dict[str, Any]:
    """Takes the first step, and measures: what a run begins with need not be in a row of its curve."""
    next(iter(session))
    return session.host.evaluator.measure(session.reconstructor)
