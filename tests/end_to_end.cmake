# Whole programs over LCM, each test in a private network namespace. 77: this machine does not allow one.
set(netns ${PROJECT_SOURCE_DIR}/scripts/netns)
add_test(NAME end_to_end COMMAND ${witness} ${netns} ${CMAKE_CURRENT_SOURCE_DIR}/end_to_end.sh
    $<TARGET_FILE:trocar-server> $<TARGET_FILE:trocar-device> ${PROJECT_SOURCE_DIR}/meshes/figure8.yaml)
if(TROCAR_SANITIZE)
    set(timing no) # instrumented programs are many times slower: their messages are checked, not their speed
else()
    set(timing yes)
endif()
set_tests_properties(end_to_end PROPERTIES ENVIRONMENT "TROCAR_CHECK_TIMING=${timing}" SKIP_RETURN_CODE 77 TIMEOUT 240 RUN_SERIAL TRUE)

# Faults injected into a running server, some of them through functions put around its own; a server that is killed.
foreach(test faults restart)
    add_executable(${test} ${test}.c)
    target_link_libraries(${test} PRIVATE trocar_service trocar_core trocar_types PkgConfig::CMOCKA m)
    target_compile_definitions(${test} PRIVATE MESHES="${PROJECT_SOURCE_DIR}/meshes")
endforeach()
target_link_options(faults PRIVATE -Wl,--wrap=clock_gettime,--wrap=remesher_serve,--wrap=insertion_tick,--wrap=coupling_hold)
add_test(NAME faults COMMAND ${witness} ${netns} $<TARGET_FILE:faults>)
add_test(NAME restart COMMAND ${witness} ${netns} $<TARGET_FILE:restart> ${PROJECT_SOURCE_DIR}/scripts/keep_alive $<TARGET_FILE:trocar-server>)
set_tests_properties(faults restart PROPERTIES
    ENVIRONMENT "TROCAR_CHECK_TIMING=${timing}" SKIP_RETURN_CODE 77 TIMEOUT 240 RUN_SERIAL TRUE)

# What starts it again, the unit where systemd runs.
add_test(NAME keep_alive COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/test_keep_alive.sh ${PROJECT_SOURCE_DIR}/scripts/keep_alive)
set_tests_properties(keep_alive PROPERTIES LABELS release_only)
add_test(NAME systemd_unit COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/test_unit.sh ${PROJECT_SOURCE_DIR}/scripts/packaging/trocar-server.service.in
    $<TARGET_FILE:trocar-server>)
set_tests_properties(systemd_unit PROPERTIES LABELS release_only)
