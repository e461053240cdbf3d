//! Everything that can be asked, in one table; `docs/api.md` is held against it.

use super::error::ApiError;
use super::{events, page, queue, runs, status, verbs};
use crate::front::daemon::hub::Hub;
use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::{Method, StatusCode, Uri};
use axum::routing::{MethodRouter, delete, get, post};
use std::sync::Arc;

/// Largest body of a request, bytes.
pub const LARGEST_BODY: usize = 64 << 10;

/// What every handler gets.
pub type Shared = Arc<Hub>;

/// One thing that can be asked.
pub struct Route {
    /// Method.
    pub method: Method,
    /// Path; `{…}` stands for a part of it.
    pub path: &'static str,
    handler: fn() -> MethodRouter<Shared>,
}

/// The table.
pub const ROUTES: [Route; 9] = [
    Route { method: Method::GET, path: "/", handler: || get(page::page) },
    Route { method: Method::GET, path: "/v1/status", handler: || get(status::status) },
    Route { method: Method::GET, path: "/v1/queue", handler: || get(queue::list) },
    Route { method: Method::POST, path: "/v1/queue", handler: || post(queue::add) },
    Route { method: Method::DELETE, path: "/v1/queue/{id}", handler: || delete(queue::remove) },
    Route { method: Method::POST, path: "/v1/verbs/{verb}", handler: || post(verbs::ask) },
    Route { method: Method::GET, path: "/v1/events", handler: || get(events::events) },
    Route { method: Method::GET, path: "/v1/runs", handler: || get(runs::list) },
    Route { method: Method::GET, path: "/v1/runs/{id}", handler: || get(runs::one) },
];

/// The router of the socket, or, `read_only`, of the loopback port.
pub fn router(hub: Shared, read_only: bool) -> Router {
    let mut router = Router::new();
    for route in ROUTES.iter().filter(|r| !read_only || r.method == Method::GET) {
        router = router.route(route.path, (route.handler)());
    }
    let wrong_method = move || async move { not_allowed(read_only) };
    router
        .fallback(not_found)
        .method_not_allowed_fallback(wrong_method)
        .layer(DefaultBodyLimit::max(LARGEST_BODY))
        .with_state(hub)
}

async fn not_found(uri: Uri) -> ApiError {
    ApiError::new(
        StatusCode::NOT_FOUND,
        format!("there is nothing at {}; docs/api.md tells what can be asked", uri.path()),
    )
}

fn not_allowed(read_only: bool) -> ApiError {
    let why = if read_only {
        "this port only shows; requests that change something go through the Unix socket"
    } else {
        "this method is not one for this path; docs/api.md tells which is"
    };
    ApiError::new(StatusCode::METHOD_NOT_ALLOWED, why)
}
