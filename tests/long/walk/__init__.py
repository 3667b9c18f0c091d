"""The exhaustive walk of one axis: all states that any PLC, loss or drive can bring the axis machine to.

``python -m tests.long.walk`` prints states, transitions and violations; ``make long LONG=walk`` does it for all settings.

| module | contents |
| --- | --- |
| ``machine`` | the axis machine as numbered states, ``(state, input) -> (state, output)``, computed on demand |
| ``plc``, ``drive`` | everything a PLC can send and a drive can report |
| ``monitor`` | what the safety rules (``tests/long/rules.py``) see of the power stage, without the power table |
| ``brakes`` | the same of NMT Stop and the gateway's heartbeat, in a walk of the guarding |
| ``recovery`` | an axis returns to operation from every state, with a correct but slow drive |
| ``cases`` | the telegrams and settings of the walks |
| ``handshakes`` | the walk of setpoint acknowledge, Halt, homing, mode change, jog and touch probe |
| ``shaft``, ``promises`` | its drive, which may be late and report a signal wrongly, and what the rules see of the shaft |
| ``search`` | breadth-first search to the fixpoint; the shortest trace of a violation |
"""
