//! The `goniod` program: parse, dispatch, exit code.

use goniod::front::cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
