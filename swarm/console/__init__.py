"""The console: a web page of a flight, live, with its buttons, for any number of browsers."""
