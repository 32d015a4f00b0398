"""What a step costs, and what surrounds it: one program with a section for each question."""
