"""Opens bsdf.h5 with h5py and follows the default attributes as silx does; prints what it finds as JSON.

usage: nexus.py FILE.h5
"""

import json
import sys

import h5py
import numpy


def main():
    with h5py.File(sys.argv[1], "r") as file:
        chain = [file.attrs["NX_class"]]
        node = file
        while "default" in node.attrs:
            node = node[node.attrs["default"]]
            chain.append(node.attrs["NX_class"])
        signal = node[node.attrs["signal"]]
        axes = [str(name) for name in node.attrs["axes"]]
        tables = file["entry/tables"]
        solid = tables["patch_projected_solid_angle"][:]
        hemispherical = numpy.nansum(signal[...] * solid, axis=-1)
        stored = file["entry/hemispherical/value"][...]
        print(
            json.dumps(
                {
                    "chain": chain,
                    "axes": axes,
                    "lengths_match": [node[a].shape[0] for a in axes] == list(signal.shape),
                    "shape": list(signal.shape),
                    "units": signal.attrs["units"],
                    "errors_shape": list(node["bsdf_errors"].shape),
                    "sides": [s.decode() for s in tables["side_name"][:]],
                    "quantities": [s.decode() for s in tables["quantity_name"][:]],
                    "worst_sum": float(numpy.nanmax(numpy.abs(hemispherical - stored))),
                    "title": file["entry/title"][()].decode(),
                }
            )
        )


main()
