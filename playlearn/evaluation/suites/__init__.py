"""The kinds of suites, one file each: where start states and goals come from."""
