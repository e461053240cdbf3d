//! From what the scan file says to the list of incident directions and the ladder of integration times.

use super::scan::{BasisName, Exposure, Incidence};
use crate::engine::optics::basis::AngleBasis;
use crate::engine::optics::direction::Direction;
use crate::engine::optics::side::Side;
use goniod_drivers::units::ExposureTime;

/// Most directions a scan may have.
pub const MOST_DIRECTIONS: usize = 20_000;

/// Most integration times a ladder may have.
pub const MOST_EXPOSURES: usize = 64;

/// Two directions nearer than this are the same, degrees: well below any axis tolerance.
const SAME_DEG: f64 = 1e-6;

/// An incident direction in degrees, exactly as the file says it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Incident {
    /// Polar angle of the source from the sample's normal on the source's side, 0 to below 90.
    pub theta_deg: f64,
    /// Azimuth of the source about the sample's z, x towards y, 0 to below 360.
    pub phi_deg: f64,
}

// === impl Incident ===

impl Incident {
    /// The direction with phi wrapped into 0 to below 360.
    pub fn new(theta_deg: f64, phi_deg: f64) -> Incident {
        let wrapped = phi_deg.rem_euclid(360.0);
        Incident { theta_deg, phi_deg: if wrapped >= 360.0 { 0.0 } else { wrapped } }
    }

    /// The engine's value.
    pub fn direction(self) -> Direction {
        Direction::from_degrees(self.theta_deg, self.phi_deg)
    }

    /// Whole numbers that are equal exactly where two directions are the same; on the pole the azimuth says nothing.
    pub fn key(self) -> (i64, i64) {
        let steps = |deg: f64| (deg / SAME_DEG).round() as i64;
        let theta = steps(self.theta_deg);
        (theta, if theta == 0 { 0 } else { steps(self.phi_deg) % steps(360.0) })
    }
}

// === impl Incidence ===

impl Incidence {
    /// The incident directions in the order of the file; sources, not patches.
    ///
    /// A basis gives the centres of its patches with phi + 180 degrees, because the Klems file names an incident patch
    /// by the azimuth in which light travels ([`Side::file_incident`]): so each patch of the file is hit in its centre.
    /// In a grid, one azimuth (the first) stands for all at theta 0. Where the file names several ways, all are given,
    /// in the order basis, directions, grid, ring; the check refuses that.
    pub fn incidents(&self) -> Vec<Incident> {
        let mut all = Vec::new();
        if let Some(name) = self.basis {
            let basis = name.basis();
            all.extend((0..basis.len()).filter_map(|i| basis.centre(i)).map(|centre| {
                let (theta, phi) = Side::file_incident(centre).degrees();
                // Nominal angles are multiples of 0.25 degrees or of 360/n: rounding takes the radians' tail off.
                Incident::new((theta * 1e9).round() / 1e9, (phi * 1e9).round() / 1e9)
            }));
        }
        all.extend(self.directions.iter().flatten().map(|[theta, phi]| Incident::new(*theta, *phi)));
        if let Some(grid) = &self.grid {
            for &theta in &grid.theta_deg {
                let azimuths = if theta == 0.0 { 1 } else { grid.phi_deg.len() };
                all.extend(grid.phi_deg.iter().take(azimuths).map(|&phi| Incident::new(theta, phi)));
            }
        }
        if let Some(ring) = &self.ring {
            let count = ring.count.min(MOST_DIRECTIONS as u32);
            all.extend(
                (0..count).map(|k| {
                    Incident::new(ring.theta_deg, ring.start_phi_deg + 360.0 * f64::from(k) / f64::from(count))
                }),
            );
        }
        all
    }
}

// === impl BasisName ===

impl BasisName {
    /// The basis itself.
    pub fn basis(self) -> AngleBasis {
        match self {
            BasisName::KlemsFull => AngleBasis::klems_full(),
            BasisName::KlemsHalf => AngleBasis::klems_half(),
            BasisName::KlemsQuarter => AngleBasis::klems_quarter(),
        }
    }
}

// === impl Exposure ===

impl Exposure {
    /// The ladder: longest, longest/ratio, longest/ratio^2, … down to the shortest, in whole microseconds, each time
    /// once; at most [`MOST_EXPOSURES`] + 1 times, so that a caller sees that there are too many. Empty where the
    /// numbers make no ladder (ratio not above 1, times not positive).
    pub fn ladder(&self) -> Vec<ExposureTime> {
        let sound = self.ratio > 1.0 && self.shortest_s > 0.0 && self.longest_s.is_finite() && self.ratio.is_finite();
        if !sound {
            return Vec::new();
        }
        let mut times: Vec<ExposureTime> = (0..=MOST_EXPOSURES as i32)
            .map(|k| self.longest_s / self.ratio.powi(k))
            .take_while(|t| *t >= self.shortest_s * (1.0 - 1e-9))
            .map(ExposureTime::from_seconds)
            .filter(|t| t.0 > 0)
            .collect();
        times.dedup();
        times
    }
}

#[cfg(test)]
mod tests {
    use super::super::scan::{ExposurePolicy, Grid, Ring};
    use super::*;

    fn ladder(ratio: f64, shortest_s: f64, longest_s: f64) -> Vec<u64> {
        let e = Exposure { policy: ExposurePolicy::Ladder, ratio, shortest_s, longest_s };
        e.ladder().iter().map(|t| t.0).collect()
    }

    #[test]
    fn a_basis_hits_every_patch_of_the_file_once() {
        let scan = Incidence { basis: Some(BasisName::KlemsFull), ..Incidence::default() };
        let basis = AngleBasis::klems_full();
        let hit: Vec<_> = scan.incidents().iter().map(|i| basis.patch_of(Side::file_incident(i.direction()))).collect();
        assert_eq!(hit, (0..145).map(Some).collect::<Vec<_>>());
        assert_eq!(scan.incidents()[1], Incident::new(10.0, 180.0));
    }

    #[test]
    fn grids_take_the_pole_once_and_rings_are_even() {
        let grid = Grid { theta_deg: vec![0.0, 30.0], phi_deg: vec![0.0, 90.0, 180.0] };
        let scan = Incidence { grid: Some(grid), ..Incidence::default() };
        assert_eq!(scan.incidents().len(), 4);
        let ring = Ring { theta_deg: 40.0, count: 4, start_phi_deg: 315.0 };
        let scan = Incidence { ring: Some(ring), ..Incidence::default() };
        let phis: Vec<f64> = scan.incidents().iter().map(|i| i.phi_deg).collect();
        assert_eq!(phis, [315.0, 45.0, 135.0, 225.0]);
    }

    #[test]
    fn the_same_direction_has_the_same_key() {
        assert_eq!(Incident::new(0.0, 10.0).key(), Incident::new(0.0, 200.0).key());
        assert_eq!(Incident::new(30.0, 0.0).key(), Incident::new(30.0, 360.0).key());
        assert_eq!(Incident::new(30.0, -90.0).key(), Incident::new(30.0, 270.0).key());
        assert_ne!(Incident::new(30.0, 0.0).key(), Incident::new(30.0, 0.001).key());
    }

    #[test]
    fn ladders_are_whole_microseconds_down_to_the_shortest() {
        assert_eq!(ladder(8.0, 0.0078125, 4.0), [4_000_000, 500_000, 62_500, 7_813]);
        assert_eq!(ladder(4.0, 1.0, 60.0), [60_000_000, 15_000_000, 3_750_000]);
        assert_eq!(ladder(2.0, 1e-7, 1e-6), [1], "no time twice, none of zero");
        assert!(ladder(1.0, 0.1, 1.0).is_empty() && ladder(f64::NAN, 0.1, 1.0).is_empty());
        assert_eq!(ladder(1.0001, 1e-3, 60.0).len(), MOST_EXPOSURES + 1);
    }
}
