"""The native half of `joulebus` with the lab: `import joulebus` takes it from here."""
