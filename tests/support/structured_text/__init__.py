"""Structured Text (IEC 61131-3, second edition): an interpreter of the subset that ``pdgw map`` generates."""
