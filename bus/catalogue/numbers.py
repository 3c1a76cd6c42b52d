"""The numbers of the 40 parameters by name (manual, section 4.0): the one place that names them."""

MAX_RPM = 1
MAX_DISPLAY = 2
DECIMALS = 3
BASE_RATIO = 4
ENCODER_PPR = 5
ACCELERATION = 6
DECELERATION = 7
FOLLOWER_MODE = 8
PRESET_SPEED = 9
JUMP_UP = 10
JUMP_DOWN = 11
AT_SPEED_WINDOW = 12
JUMP_MODE = 13
FREEZE_MODE = 14
DISPLAY_RATE = 15
SETUP_DURING_RUN = 16
OWN_ADDRESS = 17
"""Every unit has it and only its panel changes it (manual, 4.0), so its value is known beforehand. If it
reads as another address, another unit responds there; the address in a response is no evidence, because it
repeats that of the request.
"""
BAUD_RATE = 18
CONTROL_MODE = 19
SPEED_SETPOINT = 20
PASSWORD = 21
ANALOG_IN_LOW = 22
ANALOG_IN_HIGH = 23
ANALOG_IN_MODE = 24
ANALOG_IN_RATE = 25
ANALOG_IN_TRIM = 26
PROTOCOL = 27
ANALOG_OUT_SOURCE = 28
ANALOG_OUT_LOW = 29
ANALOG_OUT_HIGH = 30
MAX_RATIO = 31
PRESET_INPUT_MODE = 32
REVERSE_INPUT_MODE = 33
UP_INPUT_MODE = 34
DOWN_INPUT_MODE = 35
INSTALLED_OPTION = 36
RATIO_SETPOINT = 37
MIN_RATIO = 38
DEBOUNCE = 39
AT_SPEED_SOURCE = 40
SETPOINTS = (SPEED_SETPOINT, RATIO_SETPOINT)
"""In these a unit keeps what a host or a panel commands; every other one changes by its set-up alone."""
