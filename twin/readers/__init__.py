"""Recorded traces of other makers into campaigns.

formats   readers by file ending: delimited (CSV), sinumerik (XML), tdms, mdf, matlab, parquet; `signals` is what each returns
mapping   the map: column -> axis and signal, unit, scale, sign, time           convert    recorded number -> SI
timing    interval, gaps, rounded and jittering clocks                          grid       signals of several intervals on one grid
plausible swapped units from signals that contradict each other                 skew       how late a channel was recorded
understand  one run from all of these      write  traces, campaign.toml      output  table and picture      command  `twin import`
"""

from twin.readers.command import add_import_arguments, import_campaign, import_command
from twin.readers.mapping import read_map

__all__ = ["add_import_arguments", "import_campaign", "import_command", "read_map"]
