"""Fault injection: processes that are killed or stopped, cut connections and full disks."""
