"""The demo: a week of New York Harbor."""
