def report() -> None:
    ''
