"""The command line: a shell around the library that turns errors into exit codes."""
