"""The Debian package: its contents, its manual pages, and the check that installs, starts, upgrades and purges it."""
