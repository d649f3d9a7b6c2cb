def explain() -> None:
    ''
