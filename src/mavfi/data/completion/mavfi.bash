# Completes commands of mavfi in bash.  To use it in every new shell: mavfi completion bash >> ~/.bashrc
_mavfi_completion() {
    local IFS=$'\n' reply
    # The line up to the cursor, since bash splits words at colons, and faults have some.
    local line="${COMP_LINE:0:COMP_POINT}"
    local word="${line##* }"
    # bash replaces what follows the last colon: what stands before it must not be in a reply.
    local before=""
    if [[ $COMP_WORDBREAKS == *:* ]]; then
        before="${word%"${word##*[:=]}"}"
    fi
    COMPREPLY=()
    for reply in $(_MAVFI_COMPLETE=complete_fish _TYPER_COMPLETE_FISH_ACTION=get-args \
        _TYPER_COMPLETE_ARGS="$line" "$1" 2>/dev/null); do
        reply="${reply%%$'\t'*}"
        COMPREPLY+=("${reply#"$before"}")
    done
    # More can follow these characters.
    if [[ ${#COMPREPLY[@]} == 1 && ${COMPREPLY[0]} == *[:.=@] ]]; then
        compopt -o nospace
    fi
}
complete -o default -F _mavfi_completion mavfi
