"""PROFINET: the IO device's side, sans-I/O, and the record access that both links share.

Source: IEC 61158-5-10/-6-10 and IEC 61784-2 (conformance class B without MRP, RT_CLASS_1), as Wireshark, scapy and
captures of real controllers show them. Frames, datagrams and monotonic nanoseconds in; frames, datagrams and events out.
"""
