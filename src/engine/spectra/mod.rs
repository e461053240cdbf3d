//! Spectra: curves, filter stacks, kernels, combination of bands.
