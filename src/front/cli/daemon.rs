//! What the commands that ask the daemon share: where it is, one request, its refusals as exit codes.

use super::exit::Exit;
use super::input::instrument_path;
use super::output::Failure;
use crate::config::daemon::Daemon;
use crate::config::instrument::Instrument;
use crate::config::load::load;
use crate::front::api::answers::Status;
use crate::front::api::client::{Client, ClientError};
use crate::front::daemon::serve::USUAL_SOCKET;
use hyper::Method;
use std::path::{Path, PathBuf};

/// Where the daemon is.
#[derive(Debug, Clone, clap::Args)]
pub struct DaemonArgs {
    /// The daemon's socket [default: $GONIOD_SOCKET, `[daemon] socket` of the instrument file, /run/goniod/goniod.sock].
    #[arg(long, value_name = "FILE")]
    pub socket: Option<PathBuf>,
    /// The instrument file [default: $GONIOD_INSTRUMENT, config/instrument.toml, /etc/goniod/instrument.toml].
    #[arg(long, value_name = "FILE")]
    pub instrument: Option<PathBuf>,
}

// === impl DaemonArgs ===

impl DaemonArgs {
    /// The socket of the daemon that is to be asked.
    pub fn find(&self) -> PathBuf {
        // Without an instrument file the usual place is asked.
        let daemon = || {
            let path = instrument_path(self.instrument.as_deref()).ok()?;
            Some(load::<Instrument>(&path, "instrument").ok()?.value.daemon)
        };
        socket_path(self.socket.as_deref(), || daemon().unwrap_or_default())
    }
}

/// The socket: as given, else by the environment, the instrument file, the service manager, the usual place.
pub fn socket_path(given: Option<&Path>, daemon: impl FnOnce() -> Daemon) -> PathBuf {
    let given = given.map(Path::to_owned).or_else(|| std::env::var_os("GONIOD_SOCKET").map(PathBuf::from));
    given.or_else(|| daemon().socket).unwrap_or_else(|| match std::env::var_os("RUNTIME_DIRECTORY") {
        Some(folder) => PathBuf::from(folder).join("goniod.sock"),
        None => USUAL_SOCKET.into(),
    })
}

/// Asks the daemon, on a runtime of its own.
///
/// # Errors
/// [`ClientError`].
pub fn asked<T, F>(args: &DaemonArgs, ask: impl FnOnce(Client) -> F) -> Result<T, ClientError>
where
    F: Future<Output = Result<T, ClientError>>,
{
    let socket = args.find();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime.map_err(|e| ClientError::Garbled { socket: socket.clone(), why: e.to_string() })?;
    runtime.block_on(async { ask(Client::new(socket)).await })
}

/// True where a daemon answers.
pub fn runs(args: &DaemonArgs) -> bool {
    asked(args, |client| async move { client.ask::<Status>(Method::GET, "/v1/status", None::<&()>).await }).is_ok()
}

impl From<ClientError> for Failure {
    fn from(e: ClientError) -> Failure {
        let exit = match &e {
            ClientError::NotRunning { .. } => Exit::NoDaemon,
            ClientError::Refused { status: 422, .. } => Exit::BadInput,
            ClientError::Refused { status: 507, .. } => Exit::Storage,
            ClientError::Refused { .. } => Exit::Refused,
            ClientError::NotAllowed { .. } | ClientError::Silent { .. } | ClientError::Garbled { .. } => Exit::Failed,
        };
        match e {
            ClientError::Refused { refusal, .. } if !refusal.issues.is_empty() => {
                Failure { exit, messages: refusal.issues.into_iter().map(|i| i.text).collect() }
            }
            e => Failure::new(exit, e.to_string()),
        }
    }
}
