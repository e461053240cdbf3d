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
    axis.move_absolute(6400, Units.NATIVE, velocity=60000, velocity_unit=Units.NATIVE, acceleration=300,
                       acceleration_unit=Units.NATIVE)
    found["slower"] = axis.get_position(Units.NATIVE)
    axis.storage.set_string("note", "a text that is longer than one line of eighty characters " * 2)
    found["note"] = [len(axis.storage.get_string("note")), axis.storage.key_exists("none")]
    axis.driver_disable()
    found["off"] = sorted(axis.warnings.get_flags())
    axis.driver_enable()
    devices[2].renumber(9)
    found["renumbered"] = [[d.device_address for d in connection.detect_devices(identify_devices=False)],
                           connection.renumber_devices(1)]
    print(json.dumps(found))
