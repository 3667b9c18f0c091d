"""Simulators: CANopen nodes, drives, encoders, PLC, controller, and their faults."""
