"""Adapters: the words of a telegram, by their names, to a ``Demand``, and a ``Report`` to words. One module for each family."""
