"""Adapters: words of a telegram to a ``Demand``, a ``Report`` to words; one module for each family.

An adapter decides nothing: what a bit causes is the machine's matter. A new telegram is a row in
``gateway/axis/telegrams.py`` and, if its words are new, a module here.

Tests that find a mistake: ``tests/gateway/axis/test_telegram_signals.py``, ``test_status_words.py``, ``test_statements.py``
(the sentences of the profile), ``tests/conformance``.
"""
