//! Refusals: a status code and one sentence as JSON.

use crate::config::error::{ConfigError, Issue, Severity};
use crate::front::daemon::error::DaemonError;
use axum::Json;
use axum::extract::rejection::{JsonRejection, PathRejection, QueryRejection};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};

/// A refusal on its way to the client.
#[derive(Debug)]
pub struct ApiError {
    status: StatusCode,
    body: Refusal,
}

/// The body of every answer that is no success.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Refusal {
    /// One sentence: what, where, what to do.
    pub error: String,
    /// The faults of a scan and its instrument, each with its place; only with status 422.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub issues: Vec<Place>,
}

/// One fault of a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// `error` or `warning`.
    pub severity: String,
    /// The file.
    pub file: String,
    /// Line, counted from 1.
    pub line: usize,
    /// Column in characters, counted from 1.
    pub column: usize,
    /// The key.
    pub key: String,
    /// What is wrong and what to do.
    pub message: String,
    /// The same with place and the line of the file, as `goniod check` shows it.
    pub text: String,
}

// === impl ApiError ===

impl ApiError {
    /// A refusal with one sentence.
    pub fn new(status: StatusCode, error: impl Into<String>) -> ApiError {
        ApiError { status, body: Refusal { error: error.into(), issues: Vec::new() } }
    }

    /// A fault of our own: a task that did not come back.
    pub fn broken(e: &tokio::task::JoinError) -> ApiError {
        ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, format!("a fault of the program itself: {e}"))
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        (self.status, Json(self.body)).into_response()
    }
}

impl From<DaemonError> for ApiError {
    fn from(e: DaemonError) -> ApiError {
        let status = match &e {
            DaemonError::Config(_) | DaemonError::Plan(_) => StatusCode::UNPROCESSABLE_ENTITY,
            DaemonError::NoEntry(_) => StatusCode::NOT_FOUND,
            DaemonError::NotWaiting { .. } | DaemonError::InUse { .. } => StatusCode::CONFLICT,
            DaemonError::Full(_) => StatusCode::TOO_MANY_REQUESTS,
            DaemonError::Archive(e) if e.is_full() => StatusCode::INSUFFICIENT_STORAGE,
            _ => StatusCode::INTERNAL_SERVER_ERROR,
        };
        match e {
            DaemonError::Config(ConfigError::Faulty { issues }) => {
                let errors = issues.iter().filter(|i| i.severity == Severity::Error).count();
                let error =
                    format!("the scan cannot be queued: {errors} fault(s) in scan and instrument; correct them");
                ApiError { status, body: Refusal { error, issues: issues.iter().map(Place::of).collect() } }
            }
            e => ApiError::new(status, e.to_string()),
        }
    }
}

impl From<JsonRejection> for ApiError {
    fn from(e: JsonRejection) -> ApiError {
        ApiError::new(e.status(), format!("the body cannot be used: {}", e.body_text()))
    }
}

impl From<PathRejection> for ApiError {
    fn from(e: PathRejection) -> ApiError {
        ApiError::new(e.status(), format!("the path cannot be used: {}", e.body_text()))
    }
}

impl From<QueryRejection> for ApiError {
    fn from(e: QueryRejection) -> ApiError {
        ApiError::new(e.status(), format!("the query cannot be used: {}", e.body_text()))
    }
}

// === impl Place ===

impl Place {
    fn of(issue: &Issue) -> Place {
        let severity = match issue.severity {
            Severity::Error => "error",
            Severity::Warning => "warning",
        };
        Place {
            severity: severity.to_owned(),
            file: issue.path.display().to_string(),
            line: issue.line,
            column: issue.column,
            key: issue.key.clone(),
            message: issue.message.clone(),
            text: issue.to_string(),
        }
    }
}
