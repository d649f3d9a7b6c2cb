#compdef mavfi
# Completes commands of mavfi in zsh.  To use it in every new shell: mavfi completion zsh >> ~/.zshrc
autoload -Uz compinit
(( $+functions[compdef] )) || compinit
_mavfi_completion() {
    local -a replies values
    replies=("${(@f)$(_MAVFI_COMPLETE=complete_fish _TYPER_COMPLETE_FISH_ACTION=get-args \
        _TYPER_COMPLETE_ARGS="${(j: :)words[1,CURRENT]}" $words[1] 2>/dev/null)}")
    values=(${replies%%$'\t'*})
    if (( ! $#values )); then
        _files
        return
    fi
    # More can follow these characters; after all others a space.
    compadd -S '' -- ${(M)values:#*[:.=@]}
    compadd -- ${values:#*[:.=@]}
}
compdef _mavfi_completion mavfi
