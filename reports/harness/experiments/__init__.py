"""Tables and figures as data: specified, planned, run and recorded."""
