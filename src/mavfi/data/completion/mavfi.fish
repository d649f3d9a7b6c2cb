# Completes commands of mavfi in fish.  To use it: mavfi completion fish > ~/.config/fish/completions/mavfi.fish
function __mavfi_completion
    set --local words (commandline --cut-at-cursor --current-process)
    set --local replies (env _MAVFI_COMPLETE=complete_fish _TYPER_COMPLETE_FISH_ACTION=get-args \
        _TYPER_COMPLETE_ARGS="$words" (string split ' ' -- $words)[1] 2>/dev/null)
    if test -n "$replies"
        printf '%s\n' $replies
    else
        __fish_complete_path (commandline --current-token)
    end
end
complete --command mavfi --no-files --arguments '(__mavfi_completion)'
