"""Numbers of the profile's parameters by name; ``profidrive.parameters.catalogue`` describes them.

Source: PROFIdrive profile 4.1 chapter 6.2 and 6.3.9, encoder profile 4.2.
"""

from __future__ import annotations

import enum


class Pnu(enum.IntEnum):
    """A parameter of the profile."""

    SETPOINT_SIGNALS = 915
    ACTUAL_SIGNALS = 916
    NODE_ADDRESS = 918
    DEVICE_NAME = 919
    TELEGRAM = 922
    SIGNAL_LIST = 923
    SIGN_OF_LIFE_BIT = 924
    SIGN_OF_LIFE_TOLERANCE = 925
    OPERATION_PRIORITY = 927
    CONTROL_PRIORITY = 928
    OPERATING_MODE = 930
    FAULT_COUNTER = 944
    FAULT_CODE = 945
    FAULT_CODE_LIST = 946
    FAULT_NUMBER = 947
    FAULT_TIME = 948
    FAULT_VALUE = 949
    FAULT_NUMBER_LIST = 951
    FAULT_SITUATIONS = 952
    WARNING_WORD = 953
    BAUD_RATE = 963
    DRIVE_UNIT = 964
    PROFILE = 965
    STW1 = 967
    ZSW1 = 968
    LOAD = 970
    SAVE = 971
    RESET = 972
    PARAMETER_ACCESS = 974
    DRIVE_OBJECT = 975
    LOAD_DEVICE = 976
    SAVE_DEVICE = 977
    DRIVE_OBJECTS = 978
    SENSOR_FORMAT = 979
    REFERENCE_SPEED = 60000
    STATION_NAME = 61000
    STATION_IP = 61001
    STATION_MAC = 61002
    STATION_GATEWAY = 61003
    STATION_MASK = 61004
    PRESET_VALUE = 65000
    OPERATING_STATUS = 65001
