"""Any telemetry log as a stream of timed MAVLink frames: docs/logs.md.

log = open_log(path)
for record in log.records(): ...   # record.time_us, record.frame
log.findings, log.missing()        # what was odd about it, and what it lacks
"""

from companion.telemetry.logs.anomalies import Anomaly, LogAnomaly
from companion.telemetry.logs.needed import Kind, Missing
from companion.telemetry.logs.opening import open_log
from companion.telemetry.logs.record import Log, Record

__all__ = ["Anomaly", "Kind", "Log", "LogAnomaly", "Missing", "Record", "open_log"]
