//! `/v1/runs`: what the run directories tell.

use super::answers::{Missing, RunList, RunTold};
use super::error::ApiError;
use super::routes::Shared;
use crate::archive::RunDir;
use crate::archive::rows::StepState;
use crate::control::plan::document::RunDocument;
use crate::front::runs::{latest, status_of};
use crate::products::make::PRODUCTS;
use axum::Json;
use axum::extract::rejection::{PathRejection, QueryRejection};
use axum::extract::{Path, Query, State};
use axum::http::StatusCode;
use serde::Deserialize;
use std::path::{Path as FilePath, PathBuf};

/// Runs that one answer tells at most.
const MOST_RUNS: usize = 500;
/// Missing exposures that one answer tells at most.
const MOST_MISSING: usize = 1000;
/// Product files that one answer tells at most.
const MOST_FILES: usize = 1000;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Last {
    last: Option<usize>,
}

pub(super) async fn list(
    State(hub): State<Shared>,
    query: Result<Query<Last>, QueryRejection>,
) -> Result<Json<RunList>, ApiError> {
    let Query(Last { last }) = query?;
    let runs_dir = hub.facts.runs_dir.clone();
    let last = last.unwrap_or(50).min(MOST_RUNS);
    let read = move || {
        // A folder that is not there yet has no runs.
        let runs = latest(&runs_dir, last).unwrap_or_default();
        RunList { runs_dir, runs }
    };
    Ok(Json(tokio::task::spawn_blocking(read).await.map_err(|e| ApiError::broken(&e))?))
}

pub(super) async fn one(
    State(hub): State<Shared>,
    id: Result<Path<String>, PathRejection>,
) -> Result<Json<RunTold>, ApiError> {
    let Path(id) = id?;
    let path = run_path(&hub.facts.runs_dir, &id);
    let told = tokio::task::spawn_blocking(move || path.and_then(|p| told(&p)));
    let told = told.await.map_err(|e| ApiError::broken(&e))?;
    let unknown = || format!("there is no run \"{id}\" that can be read; GET /v1/runs tells which there are");
    told.map(Json).ok_or_else(|| ApiError::new(StatusCode::NOT_FOUND, unknown()))
}

/// The folder of a run, where the name is one that a run can have: it leads nowhere else.
fn run_path(runs_dir: &FilePath, id: &str) -> Option<PathBuf> {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
    (!id.is_empty() && !id.starts_with('.') && id.chars().all(plain)).then(|| runs_dir.join(id))
}

fn told(path: &FilePath) -> Option<RunTold> {
    let status = status_of(path)?;
    let dir = RunDir::open(path).ok()?;
    let document: RunDocument = toml::from_str(&dir.plan_toml().ok()?).ok()?;
    let steps = dir.with(|journal| journal.steps()).ok()?;
    let missing = steps.into_iter().filter_map(|row| match row.state {
        StepState::Missing(reason) => Some(Missing { step: row.layout.number, view: row.layout.view, reason }),
        _ => None,
    });
    let mut products = Vec::new();
    files(&path.join(PRODUCTS), path, &mut products);
    products.sort();
    Some(RunTold {
        status,
        scan: document.scan.name,
        started: document.started,
        plan_hash: document.plan.hash,
        missing: missing.take(MOST_MISSING).collect(),
        products,
    })
}

fn files(folder: &FilePath, base: &FilePath, into: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        let hidden = entry.file_name().to_string_lossy().starts_with('.');
        if entry.file_type().is_ok_and(|t| t.is_dir()) && !hidden {
            files(&path, base, into);
        } else if !hidden && into.len() < MOST_FILES {
            into.extend(path.strip_prefix(base).map(FilePath::to_owned));
        }
    }
}
