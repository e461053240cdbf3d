//! From instrument and scan to the numbered plan: which views, in which order, with which exposures.
//!
//! The night: darks of every camera; reference views; the sample, direction by direction along the travel order, the
//! bands forwards and backwards in turn; after every so many directions darks and references again; at the end the
//! references once more, so that the lamp's drift lies between two of them everywhere.

use super::forecast::{Timing, forecast};
use super::hash::hash;
use super::order::{Target, order};
use super::{FrameArray, Plan, Step, Subject, View};
use crate::config::incidence::MOST_EXPOSURES;
use crate::config::instrument::Instrument;
use crate::config::pose::{Pose, Unreachable};
use crate::config::scan::{ReferenceMode, Scan};
use goniod_drivers::units::{ExposureTime, Slot};
use std::collections::BTreeMap;
use thiserror::Error;

/// Most steps a plan may have.
const MOST_STEPS: usize = 20_000_000;

/// Why there is no plan. After a check of the files only a slip of the program leads here.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PlanError {
    /// The ladder is empty or too long.
    #[error(
        "the exposure ladder has {count} times, but must have 1 to {MOST_EXPOSURES}; correct ratio, shortest_s and longest_s"
    )]
    Ladder {
        /// Number of times.
        count: usize,
    },
    /// A camera cannot expose so long or so short.
    #[error(
        "camera {camera} cannot expose {exposure}, only {shortest_s} to {longest_s} s; correct shortest_s or longest_s of the scan"
    )]
    Exposure {
        /// Camera name.
        camera: String,
        /// The time asked for.
        exposure: ExposureTime,
        /// The camera's shortest time.
        shortest_s: f64,
        /// The camera's longest time.
        longest_s: f64,
    },
    /// A band that no slot of the wheel has, or whose slot has no camera of the instrument.
    #[error("band {band} has no slot with a camera in the filter wheel; correct bands.use")]
    NoSlot {
        /// Band name.
        band: String,
    },
    /// A direction or reference the holder cannot show.
    #[error("{what} cannot be shown: {why}")]
    Pose {
        /// Direction and side, or reference.
        what: String,
        /// The reason.
        why: Unreachable,
    },
    /// A reference that the instrument does not have.
    #[error("the instrument has no {kind} diffuser; add it, or measure in irradiance mode")]
    NoReference {
        /// `reflecting` or `transmitting`.
        kind: &'static str,
    },
    /// Nothing to measure, or far too much.
    #[error(
        "the plan would have {steps} steps, but must have 1 to {MOST_STEPS}; name fewer directions, bands or times"
    )]
    Size {
        /// Number of steps.
        steps: usize,
    },
    /// A step names a view that is not there.
    #[error("step {step} names view {view}, which the plan does not have")]
    NoSuchView {
        /// Step number.
        step: u32,
        /// View index.
        view: u32,
    },
    /// A view names a camera that is not there.
    #[error("view {view} names camera {camera}, which the instrument does not have")]
    NoSuchCamera {
        /// View index.
        view: u32,
        /// Camera name.
        camera: String,
    },
    /// The plan has no text.
    #[error("the plan cannot be written: {reason}")]
    NotWritable {
        /// The reason.
        reason: String,
    },
    /// The text is no plan.
    #[error("this is not a whole plan: {reason}")]
    NotReadable {
        /// The reason.
        reason: String,
    },
}

/// A band with its place and camera.
#[derive(Debug, Clone, PartialEq)]
struct BandSlot {
    band: String,
    slot: Slot,
    camera: String,
}

/// A reference view's pose.
struct ReferencePose {
    transmission: bool,
    pose: Pose,
}

/// Collects views and steps.
struct Builder<'a> {
    bands: Vec<BandSlot>,
    /// Wheel place for darks by camera.
    dark_slots: BTreeMap<String, Slot>,
    ladder: Vec<ExposureTime>,
    references: Vec<ReferencePose>,
    scan: &'a Scan,
    views: Vec<View>,
    steps: Vec<Step>,
    array_sizes: BTreeMap<String, u32>,
    dark_repeats: u32,
    reference_repeats: u32,
    /// Bands are taken backwards next.
    backwards: bool,
}

/// Makes the plan of a scan that was checked.
///
/// # Errors
/// What the check would have told with its place in the files.
pub fn build(instrument: &Instrument, scan: &Scan, timing: &Timing) -> Result<Plan, PlanError> {
    let mut builder = Builder::new(instrument, scan)?;
    let targets = targets(instrument, scan)?;
    let count = targets.len().saturating_mul(builder.bands.len()).saturating_mul(builder.ladder.len());
    if count == 0 || count > MOST_STEPS {
        return Err(PlanError::Size { steps: count });
    }
    let home = Pose { tilt_deg: 0.0, spin_deg: 0.0, changer_deg: Some(0.0) };
    let start = builder.references.last().map_or(home, |r| r.pose);
    builder.night(&order(instrument, timing, start, &targets));
    let Builder { views, steps, ladder, array_sizes, .. } = builder;
    let exposures = ladder.len() as u32;
    let arrays =
        array_sizes.into_iter().map(|(camera, views)| FrameArray { camera, views, exposures }).collect::<Vec<_>>();
    let forecast = forecast(instrument, &views, &steps, timing)?;
    Ok(Plan { hash: hash(&views, &steps)?, views, steps, forecast, arrays })
}

/// All incident directions on all sides, unturned sides first, with their poses.
fn targets(instrument: &Instrument, scan: &Scan) -> Result<Vec<Target>, PlanError> {
    let incidents = scan.incidence.incidents();
    let mut sides = scan.incidence.sides.clone();
    sides.sort_by_key(|side| side.flipped());
    let mut all = Vec::with_capacity(sides.len() * incidents.len());
    for side in sides {
        for &incident in &incidents {
            let pose = Pose::of_sample(instrument, side, incident).map_err(|why| PlanError::Pose {
                what: format!("theta {}, phi {} on {side:?}", incident.theta_deg, incident.phi_deg),
                why,
            })?;
            all.push(Target { side, incident, pose });
        }
    }
    Ok(all)
}

/// The scan's bands in the order of their wheel places.
fn band_slots(instrument: &Instrument, scan: &Scan) -> Result<Vec<BandSlot>, PlanError> {
    let mut bands = Vec::new();
    for band in &scan.bands.names {
        let missing = || PlanError::NoSlot { band: band.clone() };
        let slots = &instrument.filter_wheel.slot;
        let (number, slot) = slots.iter().find(|(_, s)| s.band == *band).ok_or_else(missing)?;
        let camera = slot.camera.clone().filter(|c| instrument.camera.contains_key(c)).ok_or_else(missing)?;
        let slot = Slot(number.parse().map_err(|_| missing())?);
        bands.push(BandSlot { band: band.clone(), slot, camera });
    }
    bands.sort_by_key(|b| b.slot);
    Ok(bands)
}

/// The ladder, proven for every camera of the bands.
fn ladder(instrument: &Instrument, scan: &Scan, bands: &[BandSlot]) -> Result<Vec<ExposureTime>, PlanError> {
    let ladder = scan.exposure.ladder();
    if ladder.is_empty() || ladder.len() > MOST_EXPOSURES {
        return Err(PlanError::Ladder { count: ladder.len() });
    }
    for band in bands {
        let Some(camera) = instrument.camera.get(&band.camera) else { continue };
        let fits = |t: &&ExposureTime| t.seconds() >= camera.shortest_s && t.seconds() <= camera.longest_s;
        if let Some(exposure) = ladder.iter().find(|t| !fits(t)) {
            return Err(PlanError::Exposure {
                camera: band.camera.clone(),
                exposure: *exposure,
                shortest_s: camera.shortest_s,
                longest_s: camera.longest_s,
            });
        }
    }
    Ok(ladder)
}

/// The reference poses that the scan's sides need; none in irradiance mode.
fn references(instrument: &Instrument, scan: &Scan) -> Result<Vec<ReferencePose>, PlanError> {
    let mut poses = Vec::new();
    if scan.reference.mode == ReferenceMode::Irradiance {
        return Ok(poses);
    }
    for (kind, transmission, reference) in [
        ("transmitting", true, &instrument.reference.transmission),
        ("reflecting", false, &instrument.reference.reflection),
    ] {
        if scan.incidence.sides.iter().any(|s| s.is_transmission() == transmission) {
            let reference = reference.as_ref().ok_or(PlanError::NoReference { kind })?;
            let pose = Pose::of_reference(instrument, transmission, reference.theta_deg)
                .map_err(|why| PlanError::Pose { what: format!("the {kind} diffuser"), why })?;
            poses.push(ReferencePose { transmission, pose });
        }
    }
    Ok(poses)
}

// === impl Builder ===

impl<'a> Builder<'a> {
    fn new(instrument: &Instrument, scan: &'a Scan) -> Result<Builder<'a>, PlanError> {
        let bands = band_slots(instrument, scan)?;
        let blank = instrument.filter_wheel.slot.iter().find(|(_, s)| s.band == "dark");
        let blank = blank.and_then(|(number, _)| number.parse().ok()).map(Slot);
        let mut dark_slots = BTreeMap::new();
        for band in &bands {
            dark_slots.entry(band.camera.clone()).or_insert(blank.unwrap_or(band.slot));
        }
        Ok(Builder {
            ladder: ladder(instrument, scan, &bands)?,
            references: references(instrument, scan)?,
            bands,
            dark_slots,
            scan,
            views: Vec::new(),
            steps: Vec::new(),
            array_sizes: BTreeMap::new(),
            dark_repeats: 0,
            reference_repeats: 0,
            backwards: false,
        })
    }

    fn night(&mut self, way: &[Target]) {
        let Some(first) = self.references.first().map(|r| r.pose).or(way.first().map(|t| t.pose)) else { return };
        self.darks(first);
        self.reference_views();
        let due = |every: u32, done: usize| every > 0 && done.is_multiple_of(every as usize) && done < way.len();
        for (n, target) in way.iter().enumerate() {
            let subject = Subject::Sample { side: target.side, incident: target.incident.direction() };
            self.bands_of(&subject, 0, target.pose);
            if due(self.scan.dark.every_directions, n + 1) {
                self.darks(target.pose);
            }
            if due(self.scan.reference.every_directions, n + 1) {
                self.reference_views();
            }
        }
        self.reference_views();
    }

    /// A set of darks of every camera in the pose the bench has or is about to take: nothing turns for a dark but the
    /// wheel to its blank.
    fn darks(&mut self, pose: Pose) {
        let frames = self.scan.dark.frames;
        for (camera, slot) in self.dark_slots.clone() {
            for n in 0..frames {
                let place = BandSlot { band: String::new(), slot, camera: camera.clone() };
                self.view(Subject::Dark, self.dark_repeats + n, &place, pose);
            }
        }
        self.dark_repeats += frames;
    }

    fn reference_views(&mut self) {
        let poses: Vec<(bool, Pose)> = self.references.iter().map(|r| (r.transmission, r.pose)).collect();
        for (transmission, pose) in poses {
            self.bands_of(&Subject::Reference { transmission }, self.reference_repeats, pose);
        }
        self.reference_repeats += 1;
    }

    /// One view a band, in the order that needs no turn of the wheel at the beginning.
    fn bands_of(&mut self, subject: &Subject, repeat: u32, pose: Pose) {
        let mut bands = self.bands.clone();
        if self.backwards {
            bands.reverse();
        }
        self.backwards = !self.backwards;
        for band in &bands {
            self.view(subject.clone(), repeat, band, pose);
        }
    }

    fn view(&mut self, subject: Subject, repeat: u32, place: &BandSlot, pose: Pose) {
        let next = self.array_sizes.entry(place.camera.clone()).or_insert(0);
        let view = View {
            id: self.views.len() as u32,
            array_index: *next,
            camera: place.camera.clone(),
            band: (subject != Subject::Dark).then(|| place.band.clone()),
            subject,
            repeat,
            slot: place.slot,
            tilt_deg: pose.tilt_deg,
            spin_deg: pose.spin_deg,
            changer_deg: pose.changer_deg,
        };
        *next += 1;
        for (index, exposure) in self.ladder.iter().enumerate() {
            let number = self.steps.len() as u32;
            self.steps.push(Step { number, view: view.id, exposure_index: index as u32, exposure: *exposure });
        }
        self.views.push(view);
    }
}
