"""Models: the System, its contacts, and the port structure that harmonic balance condenses onto."""
