"""Reads a Klems XML with Radiance's library and the LBNL engine; prints T and R as JSON.

usage: klems.py radiance|lbnl|solar FILE.xml THETA,PHI [THETA,PHI ...]
       klems.py orientation FILE.xml THETA,PHI THETA,PHI   (incident, outgoing to the interior)
THETA, PHI: incident patch in the file's own words (azimuth in which the light travels), degrees.
Output of the first three: {"T": [...], "Rf": [...], "Rb": [...]} one value a direction; T and Rf for light from the exterior.
"""

import json
import sys


def radiance(path, directions):
    from pyradiance import bsdf

    data = bsdf.load_file(path)
    transmit = bsdf.SAMPLE_ALL & ~bsdf.SAMPLE_R
    reflect = bsdf.SAMPLE_ALL & ~bsdf.SAMPLE_T
    result = {"T": [], "Rf": [], "Rb": []}
    for theta, phi in directions:
        # Radiance wants the vector to the source; its +z is the interior.
        source = (phi + 180.0) % 360.0
        result["T"].append(bsdf.direct_hemi(data, 180.0 - theta, source, transmit))
        result["Rf"].append(bsdf.direct_hemi(data, 180.0 - theta, source, reflect))
        result["Rb"].append(bsdf.direct_hemi(data, theta, source, reflect))
    return result


def orientation(path, directions):
    from pyradiance import bsdf

    data = bsdf.load_file(path)
    (theta_in, phi_in), (theta_out, phi_out) = directions
    result = {}
    for name, shift in [("named by travel", 180.0), ("named by source", 0.0)]:
        source = (phi_in + shift) % 360.0
        result[name] = float(bsdf.query(data, 180.0 - theta_in, source, theta_out, phi_out)[1])
    return result


def klems_full():
    """Projected solid angles and a look-up of Klems Full, made anew here."""
    import math

    bounds = [0, 5, 15, 25, 35, 45, 55, 65, 75, 90]
    counts = [1, 8, 16, 20, 24, 24, 24, 16, 12]
    solid = []
    for low, high, count in zip(bounds, bounds[1:], counts):
        ring = math.sin(math.radians(high)) ** 2 - math.sin(math.radians(low)) ** 2
        solid += [math.pi * ring / count] * count

    def patch(theta, phi):
        ring = next(r for r, high in enumerate(bounds[1:]) if theta < high)
        return sum(counts[:ring]) + int(phi / 360.0 * counts[ring] + 0.5) % counts[ring]

    return solid, patch


def lbnl(path, directions, method="PHOTOPIC"):
    """The engine needs seconds for each incident direction: it is asked for the last one, the others are summed from the
    matrices that it gives back with that answer; both ways must agree there."""
    import pywincalc

    layer = pywincalc.parse_bsdf_xml_file(path)
    hemisphere = pywincalc.BSDFHemisphere.create(pywincalc.BSDFBasisType.FULL)
    system = pywincalc.GlazingSystem(solid_layers=[layer], bsdf_hemisphere=hemisphere)
    answer = system.optical_method_results(method, *directions[-1]).system_results
    solid, patch = klems_full()
    result = {}
    for name, part in [
        ("T", answer.front.transmittance),
        ("Rf", answer.front.reflectance),
        ("Rb", answer.back.reflectance),
    ]:
        matrix = part.matrix
        columns = [patch(theta, phi) for theta, phi in directions]
        result[name] = [sum(l * row[c] for l, row in zip(solid, matrix)) for c in columns]
        assert abs(result[name][-1] - part.direct_hemispherical) < 1e-9, name
    return result


def solar(path, directions):
    return lbnl(path, directions, "SOLAR")


def main():
    reader, path, *words = sys.argv[1:]
    directions = [tuple(float(x) for x in word.split(",")) for word in words]
    readers = {"radiance": radiance, "lbnl": lbnl, "solar": solar, "orientation": orientation}
    print(json.dumps(readers[reader](path, directions)))


main()
