"""Drives a PM100 behind the USB/IP server argv[1] with PyVISA-py alone, ThorlabsPM100 and PyMeasure; prints JSON."""
import json
import sys
import warnings

import usbip_bus

usbip_bus.plug_into(sys.argv[1])

import pyvisa
from pymeasure.instruments.thorlabs import ThorlabsPM100USB
from ThorlabsPM100 import ThorlabsPM100

# PyVISA-py would also look for instruments on the network.
warnings.simplefilter("ignore")
manager = pyvisa.ResourceManager("@py")
found = {"resources": [name for name in manager.list_resources() if name.startswith("USB")]}
name = found["resources"][0]
with manager.open_resource(name, read_termination="\n", timeout=5000) as link:
    found["idn"] = link.query("*IDN?")
    found["parts"] = link.query("*IDN?;" * 40 + "*IDN?").count("PM100")
    link.write("NONSENSE")
    found["status"] = [link.query("*STB?"), link.query("SYST:ERR?"), link.query("*ESR?")]
    link.write("SENS:AVER 300")
    link.timeout = 300
    try:
        link.query("READ?")
    except pyvisa.VisaIOError as error:
        found["late"] = error.abbreviation
    link.timeout = 5000
    found["again"] = [float(link.read()) > 0, link.query("*IDN?")]
    link.write("*RST")
    meter = ThorlabsPM100(inst=link)
    meter.sense.correction.wavelength = 550
    meter.sense.average.count = 10
    meter.input.pdiode.filter.lpass.state = 1
    meter.configure.scalar.power()
    found["thorlabs"] = [meter.sense.correction.wavelength, meter.sense.correction.maximum_beamdiameter,
                         meter.sense.power.dc.range.auto, meter.system.sensor.idn.split(",")[0], meter.getconfigure]
    meter.read
    found["read"] = meter.read
with ThorlabsPM100USB(name, visa_library="@py", read_termination="\n").adapter.connection as _:
    pass
meter = ThorlabsPM100USB(name, visa_library="@py", read_termination="\n")
meter.wavelength = 600
found["pymeasure"] = [meter.sensor_name, meter.wavelength, meter.wavelength_max, meter.power]
print(json.dumps(found))
