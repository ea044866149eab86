"""The SIM_* parameters that inject faults: names and defaults. Both autopilots have all of them.

ArduPilot's names keep ArduPilot's meanings; the other names exist in this emulator only.
`sitl.faults.mapping` turns values into faults.
"""

OF_ARDUPILOT: dict[str, float | int] = {
    "SIM_BARO_DRIFT": 0.0, "SIM_BATT_VOLTAGE": 0.0, "SIM_ENGINE_FAIL": 0, "SIM_ENGINE_MUL": 1.0,
    "SIM_GPS1_ENABLE": 1, "SIM_GPS1_GLTCH_X": 0.0, "SIM_GPS1_GLTCH_Y": 0.0,
    "SIM_GPS1_GLTCH_Z": 0.0, "SIM_RC_FAIL": 0, "SIM_UART_LOSS": 0.0, "SIM_WIND_DIR": 180.0,
    "SIM_WIND_SPD": 0.0, "SIM_WIND_TURB": 0.0,
}  # fmt: skip
OWN: dict[str, float | int] = {
    "SIM_ARM_REFUSE": 0, "SIM_CLOCK_MUL": 1.0, "SIM_DISARM": 0, "SIM_FREEZE": 0.0,
    "SIM_GRIP_FAIL": 0, "SIM_LANDED": 0, "SIM_LEAVE": 0, "SIM_LINK_BANDW": 0.0,
    "SIM_LINK_BURST": 0.0, "SIM_LINK_DELAY": 0.0, "SIM_LINK_DIR": 0, "SIM_LINK_DUP": 0.0,
    "SIM_LINK_JITTER": 0.0, "SIM_LINK_LOSS": 0.0, "SIM_LINK_REORD": 0.0, "SIM_ORIGIN_E": 0.0,
    "SIM_ORIGIN_N": 0.0, "SIM_PILOT": 0, "SIM_POS_LOSS": 0, "SIM_REBOOT": 0, "SIM_SNAG_ARC": -1.0,
    "SIM_SNAG_HOLD": 0.0,
}  # fmt: skip
PARAMETERS = OF_ARDUPILOT | OWN
