"""Bad messages by the thousand, and fuzzers to run by hand."""
