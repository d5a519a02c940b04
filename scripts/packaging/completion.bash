# bash completion for trocar's programs: options from --help, values by type of option.
_trocar() {
    local cur prev words cword split
    _init_completion -s || return
    case $prev in
        --scene | --profile) _filedir '@(yaml|yml)' ;;
        --script) mapfile -t COMPREPLY < <(compgen -W "$("$1" --script list | cut -d' ' -f1) list" -- "$cur") ;;
        --task | --course) _filedir '@(yaml|yml)' ;;
        --html) _filedir html ;;
        --runs | --prepare) _filedir -d ;;
        --poses | --compare | --out | --write-log | --log) _filedir log ;;
        --csv | --shift | --seeds) _filedir csv ;;
        --json-lines) _filedir jsonl ;;
        --joystick | --secret-file) _filedir ;;
        --png) _filedir png ;;
        --cut) mapfile -t COMPREPLY < <(compgen -W "sagittal coronal axial" -- "$cur") ;;
        --theme) mapfile -t COMPREPLY < <(compgen -W "light dark" -- "$cur") ;;
        --view) mapfile -t COMPREPLY < <(compgen -W "oblique side above along" -- "$cur") ;;
        --picture) _filedir svg ;;
        --page) _filedir -d ;;
        --point) mapfile -t COMPREPLY < <(compgen -W "base tip" -- "$cur") ;;
        --orientation) mapfile -t COMPREPLY < <(compgen -W "handle fixed" -- "$cur") ;;
        --force-key) mapfile -t COMPREPLY < <(compgen -W "vector values" -- "$cur") ;;
        --images) mapfile -t COMPREPLY < <(compgen -W "echo regions none" -- "$cur") ;;
        --engine) mapfile -t COMPREPLY < <(compgen -W "local slurm" -- "$cur") ;;
        --record) mapfile -t COMPREPLY < <(compgen -W "frames" -- "$cur") ;;
        --json | --report) _filedir json ;;
        *)
            local benchmark=
            [[ $1 != *trocar-@(bench|study|plan|fit) || ${words[1]} != [a-z]* || $cword -eq 1 ]] || benchmark=${words[1]}
            if [[ $cur == -* ]]; then
                mapfile -t COMPREPLY < <(compgen -W "$(_parse_help "$1" "$benchmark --help")" -- "$cur")
                [[ ${COMPREPLY[0]-} != *= ]] || compopt -o nospace
            elif [[ $1 == *trocar-bench && $cword -eq 1 ]]; then
                mapfile -t COMPREPLY < <(compgen -W "$("$1" --help | sed -n 's/^  \([a-z]\+\)  .*/\1/p')" -- "$cur")
            elif [[ $1 == *trocar-study && $cword -eq 1 ]]; then
                mapfile -t COMPREPLY < <(compgen -W "estimate run collect summary" -- "$cur")
            elif [[ $1 == *trocar-plan && $cword -eq 1 ]]; then
                mapfile -t COMPREPLY < <(compgen -W "run check carry-out" -- "$cur")
            elif [[ $1 == *trocar-fit && $cword -eq 1 ]]; then
                mapfile -t COMPREPLY < <(compgen -W "run check" -- "$cur")
            elif [[ $1 == *trocar-@(study|plan|fit) ]]; then
                _filedir '@(yaml|yml)'
            elif [[ $1 == *trocar-score ]]; then
                _filedir log
            elif [[ $1 == *trocar-anatomy ]]; then
                _filedir '@(dcm|csv|stl|ply)'
            fi ;;
    esac
} && complete -F _trocar trocar-server trocar-device trocar-replay trocar-view trocar-top trocar-bench trocar-anatomy trocar-study trocar-plan trocar-fit trocar-score \
    trocar-dds trocar-haply trocar-slicer trocar-spacemouse
