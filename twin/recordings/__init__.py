"""Recordings: traces, campaigns, and the import of files from controls and instruments."""

from twin.recordings.campaign import Campaign, MeasuredRun, read_campaign
from twin.recordings.trace import Trace, read_trace, write_trace

__all__ = ["Campaign", "MeasuredRun", "Trace", "read_campaign", "read_trace", "write_trace"]
