"""The PROFINET IO device, sans-I/O: ``ProfinetDevice``, its model, its GSDML file.

Source: IEC 61158-5-10/-6-10 and IEC 61784-2 (conformance class B without MRP, RT_CLASS_1), as Wireshark, scapy and
captures of real controllers show them. Frames, datagrams and monotonic nanoseconds in; frames, datagrams and events out.
"""
