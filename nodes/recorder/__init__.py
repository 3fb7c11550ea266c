"""The recorder, a process of its own, so that a slow or full disk never delays the loop.

Read ``format`` first (what the file contains), then ``core`` (observations to records), ``mcap`` (records to bytes) and
``node`` (the process). ``coverage`` counts missing ticks, for recordings that are written or read, and ``away``
knows in which of them nobody was there to have any.
"""
