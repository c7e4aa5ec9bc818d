"""`pytest --by-file` prints how long the tests of each file take, as the table in tests/durations.md has it."""

from __future__ import annotations

import os
from collections import defaultdict

import pytest

SPENT = "processor time"  # a test's property [s]
START = pytest.StashKey[float]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--by-file", action="store_true", help="print the processor time of each file's tests")


def processor_time() -> float:
    """Of this process and of those that it waited for [s]: what else the machine does hardly changes it."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    item.stash[START] = processor_time()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> None:
    if call.when == "teardown":
        item.user_properties.append((SPENT, processor_time() - item.stash[START]))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    if not config.getoption("by_file"):
        return
    spent: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])  # [s] in `make test`, and of what is slow
    for report in (some for reports in terminalreporter.stats.values() for some in reports):
        if isinstance(report, pytest.TestReport) and report.when == "teardown":
            (seconds,) = (float(str(value)) for name, value in report.user_properties if name == SPENT)
            spent[report.location[0]]["slow" in report.keywords] += seconds
    terminalreporter.section("processor time by file [s]")
    terminalreporter.write_line("| file | `make test` | and `make test-all` |\n|---|---:|---:|")
    total = [sum(column[tier] for column in spent.values()) for tier in (0, 1)]
    for file, (quick, slow) in [("all", total), *sorted(spent.items(), key=lambda entry: -sum(entry[1]))]:
        terminalreporter.write_line(f"| {file} | {quick:.0f} | {quick + slow:.0f} |")
