"""The exhaustive walk of one axis: every state that a PLC, a loss and a lying drive can bring the axis machine to.

``python -m pdgw.workshop.walk`` walks and prints states, transitions and violations; ``make walk`` does it for all settings.

| module | holds |
| --- | --- |
| ``machine`` | the axis machine as a transducer: numbered states, ``(state, input) -> (state, output)``, explored when asked |
| ``plc``, ``drive`` | everything a PLC can send, a drive can show |
| ``monitor`` | what must never happen, from the profile and docs/translation.md, without the power table |
| ``brakes`` | the same for NMT Stop and the gateway's heartbeat, in a walk of the guarding |
| ``recovery`` | from every state an axis comes back, with an honest drive that is late |
| ``cases`` | which telegrams and choices are walked |
| ``search`` | breadth first to the fixpoint; a violation as its shortest trace |
"""
