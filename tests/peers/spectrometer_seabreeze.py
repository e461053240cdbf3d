"""Drives the spectrometers behind the USB/IP server argv[1] with python-seabreeze; prints JSON."""
import json
import sys

import usbip_bus

usbip_bus.plug_into(sys.argv[1])

import seabreeze

seabreeze.use("pyseabreeze")
from seabreeze.spectrometers import Spectrometer, list_devices



def linear(spectrometer):
    """Pixels after the correction by the unit's own polynomial, where the library has that for the model."""
    try:
        return len(spectrometer.intensities(correct_nonlinearity=True))
    except seabreeze.spectrometers.SeaBreezeError as error:
        return str(error)


found = {}
for device in list_devices():
    spectrometer = Spectrometer(device)
    spectrometer.integration_time_micros(20_000)
    for _ in range(2):
        spectrometer.intensities()
    wavelengths, counts = spectrometer.spectrum()
    brightest = int(counts.argmax())
    found[device.model] = {
        "serial": spectrometer.serial_number,
        "pixels": len(counts),
        "from": round(float(wavelengths[0]), 3),
        "brightest": round(float(wavelengths[brightest]), 1),
        "counts": float(counts[brightest]),
        "most": float(spectrometer.max_intensity),
        "slot": device.f.eeprom.eeprom_read_slot(15),
        "linear": linear(spectrometer),
        "limits": spectrometer.integration_time_micros_limits,
    }
    spectrometer.close()
print(json.dumps(found))
