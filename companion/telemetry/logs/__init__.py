"""Any telemetry log as a stream of timed MAVLink frames: docs/logs.md.

log = open_log(path)
for record in log.records(): ...   # record.time_us, record.frame
log.findings, log.missing()        # what was odd about it, and what it lacks
"""

from companion.telemetry.logs.log import Log, Odd, Record
from companion.telemetry.logs.needed import Kind, Missing
from companion.telemetry.logs.opening import open_log

__all__ = ["Kind", "Log", "Missing", "Odd", "Record", "open_log"]
