"""The decoder: captures of both buses to records with named values; no I/O.

* ``engine.Decoder`` turns the packets of a capture into ``records.Record`` objects (``can_records``: those of the CAN side), one
  for each packet, in order; it learns telegrams and PDO mappings on the way. Their documents are plain data with a stable schema
  (docs/recordings.md).
* ``recognise`` makes a packet of a single piece of data.
* ``selection``, ``filter``, ``changes`` choose among records; ``columns`` makes rows of them, ``statistics`` rates and loads,
  ``render`` text.
* ``lookahead`` finds the offset of two clocks (``clocks``) in the first part of both captures, ``following`` makes a timeline of
  the records as they come: each edge over both buses, with its reason; ``timeline_text`` prints it (docs/recordings.md).
* ``recording`` sorts the records of both buses by axis for ``replay``.

Reading files and buses is the business of the caller (``decoder.capture``).
"""
