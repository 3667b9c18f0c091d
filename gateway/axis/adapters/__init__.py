"""Adapters: words of a telegram to a ``Demand``, a ``Report`` to words; one module for each family."""
