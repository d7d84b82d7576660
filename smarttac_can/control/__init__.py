"""Controllers and tribometer of the stimulator, stepped once a millisecond."""
