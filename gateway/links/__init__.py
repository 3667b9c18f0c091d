"""The cyclic exchange with the PLC over UDP, and what both links share.

Here is decided which frame counts: ``new_frames`` has the rule (the PLC returns the gateway's tick), ``cyclic`` the
relationship and its watchdog. A frame that does not count changes only a counter, and ``refusals`` says why.

Tests that find a mistake: ``tests/gateway/links`` (a network with losses, copies and delays),
``tests/gateway/test_stop_times.py``, ``tests/gateway/test_routed.py``.
"""
