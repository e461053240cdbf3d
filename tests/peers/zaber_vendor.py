"""Drives a Zaber chain at the port argv[1] with the vendor's library; prints what it found as JSON."""
import json
import sys

from zaber_motion import Units
from zaber_motion.ascii import Connection
from zaber_motion.exceptions import MotionLibException

with Connection.open_serial_port(sys.argv[1]) as connection:
    connection.enable_alerts()
    devices = connection.detect_devices(identify_devices=False)
    found = {"addresses": [d.device_address for d in devices]}
    axis = devices[0].get_axis(1)
    found["homed before"] = axis.is_homed()
    axis.home()
    found["homed"] = axis.is_homed()
    axis.move_absolute(12800, Units.NATIVE)
    found["position"] = axis.get_position(Units.NATIVE)
    axis.move_relative(-800, Units.NATIVE)
    found["relative"] = axis.get_position(Units.NATIVE)
    axis.move_velocity(20000, Units.NATIVE)
    found["busy"] = axis.is_busy()
    axis.stop()
    found["maxspeed"] = axis.settings.get("maxspeed", Units.NATIVE)
    axis.settings.set("maxspeed", 150000, Units.NATIVE)
    found["set"] = axis.settings.get("maxspeed", Units.NATIVE)
    found["warnings"] = sorted(axis.warnings.clear_flags())
    try:
        axis.move_absolute(10**9, Units.NATIVE)
    except MotionLibException as error:
        found["refused"] = type(error).__name__
    found["voltage"] = devices[0].settings.get("system.voltage") > 20
    found["serial"] = devices[0].generic_command("get system.serial").data
    axis.park()
    found["parked"] = axis.is_parked()
    axis.unpark()
    print(json.dumps(found))
