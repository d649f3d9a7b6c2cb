def replay() -> None:
    ''
