"""One file for each simulator that users would pick instead; `problem.py` says what all of them are asked."""
