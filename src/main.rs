//! The command line tool: parses, runs, reports.

mod cli;

use std::io::{ErrorKind, Write};
use std::process::ExitCode;

use clap::Parser;

fn main() -> ExitCode {
    let cli = match cli::Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            // Where the message cannot be shown, the exit code still tells.
            let _ = error.print();
            return if error.use_stderr() { ExitCode::from(2) } else { ExitCode::SUCCESS };
        }
    };
    match cli.run() {
        Ok(data) => print(&data),
        Err(error) => {
            cli::status(format_args!("splatprobe: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

/// Writes a command's data to stdout. A reader that has seen enough (`splatprobe ... | head`) is no failure.
fn print(data: &str) -> ExitCode {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(data.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            cli::status(format_args!("splatprobe: stdout: {error}"));
            ExitCode::FAILURE
        }
        _ => ExitCode::SUCCESS,
    }
}
