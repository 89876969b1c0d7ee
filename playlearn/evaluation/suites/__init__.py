"""The kinds of suites: where start states and goals come from, one file a kind."""
