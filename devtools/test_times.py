"""Lists the slowest tests by processor time, which other loads on the computer change less than the time on the clock.

scripts/test -p devtools.test_times            the 30 slowest, and the sum
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Generator
import resource
import time
from typing import Any

import pytest

SHOWN = 30


def _processor_s() -> float:
    """Processor time of this process, its threads and its ended children [s]."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, Any, Any]:
    """Note the processor time at the start of a test."""
    item.stash[_BEGAN] = _processor_s()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Generator[None, Any, Any]:
    """Attach the processor time of the test to its teardown report, for the process that prints."""
    report = yield
    if call.when == "teardown":
        report.user_properties = [*report.user_properties, ("processor_s", _processor_s() - item.stash[_BEGAN])]
    return report


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print the slowest tests."""
    took: dict[str, float] = defaultdict(float)
    for reports in terminalreporter.stats.values():
        for report in reports:
            for name, value in getattr(report, "user_properties", ()):
                if name == "processor_s":
                    took[report.nodeid] += value
    if not took:
        return
    terminalreporter.section(f"slowest {SHOWN} by processor time, of {sum(took.values()):.0f} s in all")
    for name, seconds in sorted(took.items(), key=lambda row: -row[1])[:SHOWN]:
        terminalreporter.write_line(f"{seconds:8.1f} s  {name}")


_BEGAN = pytest.StashKey[float]()
