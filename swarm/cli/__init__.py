"""The command line: reads files, wires it all, turns errors into exit codes."""
